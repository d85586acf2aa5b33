// Longest paths of images with memory, and multipliers of the targets by subgradients; called by paths.py, which says what it computes.

#include <algorithm>
#include <cstdint>
#include <limits>
#include <vector>

namespace {

constexpr double NONE = -1e300;

struct Graph {
    int64_t cells, reach, bits;
    const int64_t *target, *window, *cell, *previous, *edge_begin;
    const int32_t *source, *pair;
    const int64_t *pair_from, *pair_to, *memory;
    const double* late;
};

// What a path remembers after each pair of windows, by what it remembered before: a set of bits, or -1 where the image is excluded.
std::vector<int16_t> transitions(const Graph& g, int64_t pairs) {
    const int64_t sets = int64_t(1) << g.bits;
    std::vector<int16_t> table(pairs * sets);
    for (int64_t p = 0; p < pairs; ++p) {
        const int64_t from = g.pair_from[p], to = g.pair_to[p];
        for (int64_t set = 0; set < sets; ++set) {
            int64_t next = 0;
            bool excluded = false;
            for (int64_t b = 0; b < g.bits; ++b) {
                const int64_t known = g.memory[from * g.bits + b];
                excluded |= (set >> b & 1) && known == to;
                for (int64_t c = 0; c < g.bits; ++c) {
                    const int64_t kept = g.memory[to * g.bits + c];
                    if (kept >= 0 && (kept == from || ((set >> b & 1) && kept == known))) next |= int64_t(1) << c;
                }
            }
            if (g.bits == 0) next = 0;
            table[p * sets + set] = excluded ? -1 : int16_t(next);
        }
    }
    return table;
}

struct Solver {
    const Graph& g;
    const std::vector<int16_t>& table;
    int64_t sets;
    std::vector<double> best, reached;    // value of the best path that ends with an image of the node's window by then; by cell
    std::vector<int64_t> origin, last;    // states in which these images were taken

    // Value of the best path of a satellite with nodes begin to end, where lateness has a price, and the nodes of its images, last
    // first.
    double solve(int64_t begin, int64_t end, const double* value, double price, std::vector<int64_t>& path) {
        best.assign((end - begin) * sets, NONE);
        origin.assign((end - begin) * sets, -1);
        reached.assign(g.cells + 1, 0.0);
        last.assign(g.cells + 1, -1);
        int64_t node = begin;
        std::vector<double> now(sets);
        for (int64_t c = 0; c < g.cells; ++c) {
            double top = c ? reached[c - 1] : 0.0;
            int64_t at = c ? last[c - 1] : -1;
            for (; node < end && g.cell[node] == c; ++node) {
                std::fill(now.begin(), now.end(), NONE);
                now[0] = c >= g.reach ? reached[c - g.reach] : 0.0;
                for (int64_t e = g.edge_begin[node]; e < g.edge_begin[node + 1]; ++e) {
                    const double* from = &best[(g.source[e] - begin) * sets];
                    const int16_t* next = &table[g.pair[e] * sets];
                    for (int64_t s = 0; s < sets; ++s)
                        if (next[s] >= 0 && from[s] > now[next[s]]) now[next[s]] = from[s];
                }
                const double gain = value[g.target[g.window[node]]] - price * g.late[node];
                const int64_t here = (node - begin) * sets, before = g.previous[node] < 0 ? -1 : (g.previous[node] - begin) * sets;
                for (int64_t s = 0; s < sets; ++s) {
                    const double taken = now[s] <= NONE ? NONE : now[s] + gain, kept = before < 0 ? NONE : best[before + s];
                    best[here + s] = std::max(taken, kept);
                    origin[here + s] = taken >= kept ? here + s : origin[before + s];
                    if (taken > top) top = taken, at = here + s;
                }
            }
            reached[c] = top, last[c] = at;
        }
        path.clear();
        for (int64_t state = last[g.cells - 1]; state >= 0; state = before(state, begin)) path.push_back(begin + state / sets);
        return reached[g.cells - 1];
    }

    int64_t before(int64_t state, int64_t begin) const {
        const int64_t node = begin + state / sets, set = state % sets, c = g.cell[node];
        const bool far = set == 0 && c >= g.reach;
        double top = set == 0 ? (far ? reached[c - g.reach] : 0.0) : NONE;
        int64_t result = far ? last[c - g.reach] : -1;
        for (int64_t e = g.edge_begin[node]; e < g.edge_begin[node + 1]; ++e) {
            const int64_t from = (g.source[e] - begin) * sets;
            const int16_t* next = &table[g.pair[e] * sets];
            for (int64_t s = 0; s < sets; ++s)
                if (next[s] == set && best[from + s] > top) top = best[from + s], result = origin[from + s];
        }
        return result;
    }
};

}  // namespace

extern "C" void run(
    int64_t episodes, int64_t satellites, int64_t targets, int64_t cells, int64_t reach, int64_t bits, int64_t pairs,
    const int64_t* target, const int64_t* window, const int64_t* cell, const int64_t* previous, const int64_t* node_begin,
    const int64_t* edge_begin, const int32_t* source, const int32_t* pair, const int64_t* pair_from, const int64_t* pair_to,
    const int64_t* memory, const double* late, const double* budget, const double* priority, int64_t iterations, const double* gap,
    double* multiplier, double* price, double* lower, double* upper, int64_t* chosen, int64_t longest) {
    const Graph g{cells, reach, bits, target, window, cell, previous, edge_begin, source, pair, pair_from, pair_to, memory, late};
    const auto table = transitions(g, pairs);
    Solver solver{g, table, int64_t(1) << bits, {}, {}, {}, {}};
    std::vector<double> value(targets), now(targets), direction(targets);
    std::vector<int64_t> count(targets), path, all;
    for (int64_t e = 0; e < episodes; ++e) {
        const double* p = priority + e * targets;
        double* kept = multiplier + e * targets;
        const bool limited = budget[e] < std::numeric_limits<double>::infinity();
        double toll = price[e], toll_direction = 0.0;
        std::copy(kept, kept + targets, now.begin());
        std::fill(direction.begin(), direction.end(), 0.0);
        double scale = 1.0;
        int64_t stalled = 0;
        for (int64_t k = 0; k < iterations && upper[e] - lower[e] > gap[0] * upper[e]; ++k) {
            double bound = limited ? toll * budget[e] : 0.0, feasible = 0.0, used = 0.0, spent = 0.0;
            for (int64_t t = 0; t < targets; ++t) value[t] = p[t] - now[t], bound += now[t], count[t] = 0;
            all.clear();
            for (int64_t s = e * satellites; s < (e + 1) * satellites; ++s) {
                bound += solver.solve(node_begin[s], node_begin[s + 1], value.data(), toll, path);
                for (int64_t n : path) {
                    used += late[n];
                    if (count[target[window[n]]]++ > 0 || spent + late[n] > budget[e]) continue;
                    feasible += p[target[window[n]]], spent += late[n], all.push_back(n);
                }
            }
            if (feasible > lower[e]) {
                lower[e] = feasible;
                std::fill(chosen + e * longest, chosen + (e + 1) * longest, -1);
                std::copy(all.begin(), all.begin() + std::min<int64_t>(longest, all.size()), chosen + e * longest);
            }
            stalled = bound < upper[e] * (1.0 - 1e-5) ? 0 : stalled + 1;
            if (bound < upper[e]) upper[e] = bound, price[e] = toll, std::copy(now.begin(), now.end(), kept);
            if (stalled >= 5) scale *= 0.7, stalled = 0;
            double norm = 0.0;
            for (int64_t t = 0; t < targets; ++t) {
                const double slope = double(count[t]) - 1.0;
                const bool free = p[t] > 0.0 && !(now[t] <= 0.0 && slope < 0.0) && !(now[t] >= p[t] && slope > 0.0);
                direction[t] = free ? 0.6 * direction[t] + 0.4 * slope : 0.0;
                norm += direction[t] * direction[t];
            }
            if (limited) {
                const double slope = used - budget[e];
                toll_direction = toll <= 0.0 && slope < 0.0 ? 0.0 : 0.6 * toll_direction + 0.4 * slope;
                norm += toll_direction * toll_direction;
            }
            const double step = scale * (bound - lower[e]) / std::max(norm, 1.0);
            for (int64_t t = 0; t < targets; ++t) now[t] = std::clamp(now[t] + step * direction[t], 0.0, p[t]);
            toll = std::max(0.0, toll + step * toll_direction);
        }
    }
}
