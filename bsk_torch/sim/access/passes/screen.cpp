// Pairs of satellite and place that may see each other; called by screen.py, which says what it computes.

#include <cmath>
#include <cstdint>
#include <vector>

#include "simd.h"

namespace {

using lanes::F;

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
            const double *r = places + 3 * k, norm = std::sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2]);
            x[k] = float(r[0] / norm), y[k] = float(r[1] / norm), z[k] = float(r[2] / norm);
        }
    }
};

}  // namespace

extern "C" void run(
    int64_t rows, int64_t cells, int64_t count, int64_t shared, int64_t threads, const double* places, const float* middle,
    const float* limit, int64_t* numbers, int64_t* pairs) {
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
        if (shared) mine.read(places, count);
#pragma omp for
        for (int64_t row = 0; row < rows; ++row) {
            if (!shared) mine.read(places + 3 * count * row, count);
            for (int64_t cell = 0; cell < cells; ++cell) {
                const float* direction = middle + 3 * (row * cells + cell);
                const F x(direction[0]), y(direction[1]), z(direction[2]), least(limit[row * cells + cell]);
                for (size_t first = 0; first < mine.x.size(); first += F::size()) {
                    const F a = F::loadu(&mine.x[first]), b = F::loadu(&mine.y[first]), c = F::loadu(&mine.z[first]);
                    for (uint32_t bits = above(x * a + y * b + z * c, least); bits; bits &= bits - 1)
                        found[row].push_back({int32_t(first + __builtin_ctz(bits)), int32_t(cell)});
                }
            }
        }
    }
    *numbers = 0;
    for (const auto& row : found) *numbers += row.size();
}
