// Event codes as sorted lists; called by passes.py, which says what it computes.

#include <algorithm>
#include <cstdint>
#include <vector>

namespace {

struct Event {
    int64_t row, place, sample, at_edge;
};

// starts, ends and short passes: what the first call finds, for the second one by the same thread
thread_local std::vector<Event> kept[3];

}  // namespace

extern "C" void run(
    int64_t count, int64_t samples, int64_t in_cell, int64_t last, const double* codes, const int64_t* rows,
    const int64_t* places, const int64_t* cells, int64_t* numbers, int64_t* events) {
    enum { RISE = 1, SET = 2, SHORT_PASS = 4, ABOVE_LIMIT = 8 };
    auto& [starts, ends, shorts] = kept;
    if (events) {
        for (auto& list : kept) {
            const int64_t size = list.size();
            for (int64_t k = 0; k < size; ++k) {
                const Event& event = list[k];
                events[k] = event.row, events[size + k] = event.place;
                events[2 * size + k] = event.sample, events[3 * size + k] = event.at_edge;
            }
            events += 4 * size;
            list = {};
        }
        return;
    }
    for (auto& list : kept) list.clear();
    for (int64_t pair = 0; pair < count; ++pair)
        for (int64_t k = 0; k < samples; ++k) {
            const double number = codes[pair * samples + k];
            if (!(number > 0.0)) continue;
            const int code = int(number);
            const int64_t row = rows[pair], place = places[pair], sample = cells[pair] * in_cell + k;
            if (code & RISE) starts.push_back({row, place, sample, 0});
            if (code & SET) ends.push_back({row, place, sample, 0});
            if (code & SHORT_PASS) shorts.push_back({row, place, sample, 0});
            if (code & ABOVE_LIMIT && sample == 0) starts.push_back({row, place, sample, 1});
            if (code & ABOVE_LIMIT && sample == last) ends.push_back({row, place, sample, 1});
        }
    for (auto* list : {&starts, &ends})  // the events of a pair are in the order of their times already
        std::stable_sort(list->begin(), list->end(), [](const Event& a, const Event& b) {
            return a.row != b.row ? a.row < b.row : a.place < b.place;
        });
    for (int k = 0; k < 3; ++k) numbers[k] = kept[k].size();
}
