// Pairs of satellite and place that may see each other; called by passes.py, which says what it computes.

#include <cmath>
#include <cstdint>
#include <vector>

#include "simd.h"

namespace {

using lanes::F;

constexpr int TRACK = 16;  // samples of the track of a cell, as passes.py fills it up

struct Near {
    int32_t place, cell;
};

// what the first call finds, for the second one by the same thread
thread_local std::vector<std::vector<Near>> kept;

// Bit k tells whether lane k of a is greater than that of b.
inline uint32_t above(const F& a, const F& b) {
#if defined(CPU_CAPABILITY_AVX512)
    return _mm512_cmp_ps_mask(a, b, _CMP_GT_OQ);
#elif defined(CPU_CAPABILITY_AVX2)
    return _mm256_movemask_ps(_mm256_cmp_ps(a, b, _CMP_GT_OQ));
#else
    float left[F::size()], right[F::size()];
    a.store(left), b.store(right);
    uint32_t bits = 0;
    for (int k = 0; k < F::size(); ++k) bits |= uint32_t(left[k] > right[k]) << k;
    return bits;
#endif
}

// Directions of places, plane by plane, without the missing ones (NaN) at the end, and filled up with NaN to whole registers.
struct Directions {
    std::vector<float> x, y, z;

    void read(const double* places, int64_t count) {
        while (count && std::isnan(places[3 * count - 1])) --count;
        for (auto* plane : {&x, &y, &z}) plane->assign((count + F::size() - 1) / F::size() * F::size(), NAN);
        for (int64_t k = 0; k < count; ++k) {
            const float a = places[3 * k], b = places[3 * k + 1], c = places[3 * k + 2];
            const float scale = 1.0f / std::sqrt(a * a + b * b + c * c);
            x[k] = a * scale, y[k] = b * scale, z[k] = c * scale;
        }
    }
};

// Whether a direction is near a track [3, TRACK]: a product of theirs is above the limit.
inline bool is_near(const float* track, float x, float y, float z, float limit) {
    const F a(x), b(y), c(z), least(limit);
    uint32_t bits = 0;
    for (int k = 0; k < TRACK; k += F::size())
        bits |= above(F::loadu(track + k) * a + F::loadu(track + TRACK + k) * b + F::loadu(track + 2 * TRACK + k) * c, least);
    return bits;
}

}  // namespace

extern "C" void run(
    int64_t rows, int64_t cells, int64_t count, int64_t shared, int64_t threads, const double* places, const float* middle,
    const float* limit, const float* tracks, const float* near_limit, int64_t* numbers, int64_t* pairs) {
    auto& found = kept;
    if (pairs) {
        const int64_t total = numbers[0];
        int64_t k = 0;
        for (int64_t row = 0; row < rows; ++row)
            for (const Near& near : found[row]) {
                pairs[k] = row, pairs[total + k] = near.place, pairs[2 * total + k] = near.cell;
                ++k;
            }
        found = {};
        return;
    }
    found.assign(rows, {});
#pragma omp parallel num_threads(threads) if (threads > 1)
    {
        Directions mine;
        std::vector<int32_t> hits;
        if (shared) mine.read(places, count);
#pragma omp for
        for (int64_t row = 0; row < rows; ++row) {
            if (!shared) mine.read(places + 3 * count * row, count);
            const float *x = mine.x.data(), *y = mine.y.data(), *z = mine.z.data();
            const int64_t size = mine.x.size();
            auto& list = found[row];
            hits.resize(size);
            for (int64_t cell = 0; cell < cells; ++cell) {
                const int64_t at = row * cells + cell;
                const float *direction = middle + 3 * at, *track = tracks + 3 * TRACK * at;
                const F a(direction[0]), b(direction[1]), c(direction[2]), least(limit[at]);
                int64_t number = 0, kept = list.size();
                for (int64_t first = 0; first < size; first += F::size()) {
                    const F product = F::loadu(x + first) * a + F::loadu(y + first) * b + F::loadu(z + first) * c;
                    for (uint32_t bits = above(product, least); bits; bits &= bits - 1) hits[number++] = first + __builtin_ctz(bits);
                }
                list.resize(kept + number);
                for (int64_t j = 0; j < number; ++j) {  // without branches, which nothing could predict
                    const int32_t k = hits[j];
                    list[kept] = {k, int32_t(cell)};
                    kept += is_near(track, x[k], y[k], z[k], near_limit[at]);
                }
                list.resize(kept);
            }
        }
    }
    *numbers = 0;
    for (const auto& row : found) *numbers += row.size();
}
