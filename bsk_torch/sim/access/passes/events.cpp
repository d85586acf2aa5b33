// Event codes as sorted lists; called by passes.py, which says what it computes.

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <vector>

namespace {

struct Event {
    int64_t row, place, sample, at_edge;
};

// starts, ends and short passes: what the first call finds, for the second one by the same thread
thread_local std::vector<Event> kept[3];

// Sort the events of each row by place, by counting; rows ascend, and the events of a pair are in the order of their times.
void sort_by_place(std::vector<Event>& list) {
    std::vector<Event> sorted(list.size());
    std::vector<int64_t> next;
    for (size_t first = 0, end = 0; first < list.size(); first = end) {
        int64_t most = 0;
        for (; end < list.size() && list[end].row == list[first].row; ++end) most = std::max(most, list[end].place);
        next.assign(most + 2, 0);
        for (size_t k = first; k < end; ++k) ++next[list[k].place + 1];
        std::partial_sum(next.begin(), next.end(), next.begin());
        for (size_t k = first; k < end; ++k) sorted[first + next[list[k].place]++] = list[k];
    }
    list.swap(sorted);
}

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
    for (auto* list : {&starts, &ends}) sort_by_place(*list);
    for (int k = 0; k < 3; ++k) numbers[k] = kept[k].size();
}
