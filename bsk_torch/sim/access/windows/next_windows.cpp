// The windows of each satellite that close next; called by next_windows.py, which says what it computes.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

namespace {

using Cut = std::pair<int64_t, int64_t>;  // place, which breaks the tie of windows that are cut at the same time, and column

}  // namespace

extern "C" void run(
    int64_t count, int64_t threads, const int64_t* rows, int64_t columns, const double* opens, const double* closes,
    const int64_t* places, const double* time, const double* until, const bool* allowed, int64_t kinds, int64_t width,
    int64_t none_at_first, const double* rounding, double* found_open, double* found_close, int64_t* found_place,
    int64_t* number) {
#pragma omp parallel num_threads(threads) if (threads > 1)
    {
        std::vector<Cut> cut;
#pragma omp for
        for (int64_t k = 0; k < count; ++k) {
            const int64_t row = rows ? rows[k] : k;
            const double *open = opens + row * columns, *close = closes + row * columns;
            const int64_t* place = places + row * columns;
            const bool* mine = allowed ? allowed + row * kinds : nullptr;
            const double now = time[row] + *rounding, end = until[row];
            double *to_open = found_open + k * width, *to_close = found_close + k * width;
            int64_t *to_place = found_place + k * width, found = 0;
            const auto put = [&](int64_t slot, int64_t column) {
                to_open[slot] = open[column];
                to_close[slot] = std::min(close[column], end);
                to_place[slot] = place[column];
            };
            const auto counts = [&](int64_t column) { return open[column] < end && (!mine || mine[place[column]]); };
            const int64_t first = std::lower_bound(close, close + columns, now) - close;
            if (end >= now) {
                int64_t column = first;
                for (; column < columns && close[column] < end && found < width; ++column)
                    if (counts(column)) put(found++, column);
                if (found < width) {  // all that remain are cut
                    cut.clear();
                    for (; column < columns && close[column] < INFINITY; ++column)
                        if (counts(column)) cut.emplace_back(place[column], column);
                    const auto more = std::min<int64_t>(width - found, cut.size());
                    std::partial_sort(cut.begin(), cut.begin() + more, cut.end());
                    for (int64_t c = 0; c < more; ++c) put(found++, cut[c].second);
                }
            }
            number[k] = found;
            if (found == 0) put(0, none_at_first ? std::min(first, columns - 1) : 0);
            for (int64_t slot = std::max<int64_t>(found, 1); slot < width; ++slot) {
                to_open[slot] = to_open[slot - 1];
                to_close[slot] = to_close[slot - 1];
                to_place[slot] = to_place[slot - 1];
            }
        }
    }
}
