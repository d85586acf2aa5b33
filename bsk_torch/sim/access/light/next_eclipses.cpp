// The next eclipse of each satellite; called by next_eclipses.py, which says what it computes.

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace {

struct Constants {
    double plan_step, search_step, searches, rounding, not_found;
};

// A product that is rounded before it is added to anything, as torch rounds it: compilers fuse the two otherwise.
double rounded(double product) {
    volatile double kept = product;
    return kept;
}

// The first sample of the grid from `soonest` on that follows one of the times.
double next(const double* times, int64_t columns, double soonest, double step, double origin) {
    double found = INFINITY;
    for (int64_t k = 0; k < columns; ++k) {
        const double sample = rounded(std::ceil((times[k] - origin) / step) * step) + origin;
        if (sample >= soonest) found = std::min(found, sample);
    }
    return found;
}

}  // namespace

extern "C" void run(
    int64_t count, const Constants* constants, const double* starts, int64_t start_columns, const double* ends,
    int64_t end_columns, const double* time, const double* begun, const double* reached, double* sampled, double* known,
    double* found_start, double* found_end, int64_t* late) {
    const auto [step, search_step, searches, rounding, not_found] = *constants;
    for (int64_t row = 0; reached && row < count && !*late; ++row)
        *late = std::max(time[row] + search_step * (searches - 1.0), known[row]) + 2.0 * step > reached[row];
    if (*late) return;
    for (int64_t row = 0; row < count; ++row) {
        const double now = time[row], origin = begun ? begun[row] : 0.0, slack = begun ? rounding : 0.0;
        const double elapsed = now - origin, grid = std::floor(rounded(elapsed * (1.0 / step)) + slack) + 1.0 - slack;
        const double soonest = rounded(grid * step) + origin;
        const double start = next(starts + row * start_columns, start_columns, soonest, step, origin);
        const double end = next(ends + row * end_columns, end_columns, soonest, step, origin);
        const double last = std::max(start, end) + step;
        if (last <= known[row]) {
            found_start[row] = start;
            found_end[row] = end;
            continue;
        }
        double reach = 0.0;
        bool found = false;
        for (int64_t k = 0; k < (int64_t)searches && !found; ++k) {  // what the last search finds does not count
            const double whole = std::floor((elapsed + k * search_step + step) / step + rounding);
            reach = std::max(sampled[row], whole * step + origin);
            found = k + 1 < searches && last <= reach;
        }
        sampled[row] = known[row] = reach;
        found_start[row] = found ? start : not_found;
        found_end[row] = found ? end : not_found;
    }
}
