// Lanes: W environments side by side in vector registers.
//
// D holds W doubles, F (kernels that define LANES_MIXED) as many floats, M a truth value for each. Registers are those of x86.h,
// or at::vec's on other processors; here stands what kernels need besides. Minimum and maximum keep a NaN of their first
// argument.
#pragma once
#include <cmath>
#include <cstdint>
#include <limits>

#if defined(CPU_CAPABILITY_AVX512) || defined(CPU_CAPABILITY_AVX2)
#include "x86.h"
#else
#include <ATen/cpu/vec/vec.h>
namespace lanes {
using namespace at::vec;
using V = Vectorized<double>;
using F = Vectorized<float>;
}  // namespace lanes
#endif

namespace lanes {
#ifdef LANES_MIXED
constexpr int W = F::size();

// Two vectors of doubles as plain members: compilers keep them in registers, which they do not with VectorizedN's array.
struct D {
  V low, high;
  D() = default;
  D(double x) : low(x), high(x) {}
  D(const V& l, const V& h) : low(l), high(h) {}
  static D loadu(const double* from) { return D(V::loadu(from), V::loadu(from + W / 2)); }
  void store(double* to) const {
    low.store(to);
    high.store(to + W / 2);
  }
  const V& operator[](int k) const { return k ? high : low; }
#define LANES_UNARY(name) \
  D name() const { return D(low.name(), high.name()); }
#define LANES_BINARY(name) \
  D name(const D& b) const { return D(low.name(b.low), high.name(b.high)); }
  LANES_UNARY(neg) LANES_UNARY(sqrt) LANES_UNARY(abs) LANES_UNARY(acos) LANES_UNARY(asin) LANES_UNARY(atan) LANES_UNARY(cos)
  LANES_UNARY(sin) LANES_UNARY(tan) LANES_UNARY(exp) LANES_UNARY(log) LANES_UNARY(log2) LANES_UNARY(log10) LANES_UNARY(log1p)
  LANES_UNARY(expm1) LANES_UNARY(floor) LANES_UNARY(ceil) LANES_UNARY(trunc) LANES_UNARY(round) LANES_UNARY(tanh)
  LANES_UNARY(sinh) LANES_UNARY(cosh) LANES_BINARY(atan2) LANES_BINARY(hypot) LANES_BINARY(fmod)
};
#define LANES_INFIX(op) \
  static inline D operator op(const D& a, const D& b) { return D(a.low op b.low, a.high op b.high); }
LANES_INFIX(+)
LANES_INFIX(-)
LANES_INFIX(*)
LANES_INFIX(/)
#else
using D = V;
constexpr int W = D::size();
#endif

// -- minimum and maximum -------------------------------------------------------------------------------------------------

#if defined(CPU_CAPABILITY_AVX512)
#define LANES_EXTREME(name, op)                                                     \
  static inline V name(const V& a, const V& b) { return _mm512_##op##_pd(b, a); }   \
  static inline F name(const F& a, const F& b) { return _mm512_##op##_ps(b, a); }
#elif defined(CPU_CAPABILITY_AVX2)
#define LANES_EXTREME(name, op)                                                     \
  static inline V name(const V& a, const V& b) { return _mm256_##op##_pd(b, a); }   \
  static inline F name(const F& a, const F& b) { return _mm256_##op##_ps(b, a); }
#else
#define LANES_EXTREME(name, op)                                                     \
  static inline V name(const V& a, const V& b) { return at::vec::name(a, b); }      \
  static inline F name(const F& a, const F& b) { return at::vec::name(a, b); }
#endif
LANES_EXTREME(minimum, min)
LANES_EXTREME(maximum, max)
#ifdef LANES_MIXED
static inline D minimum(const D& a, const D& b) { return D(minimum(a[0], b[0]), minimum(a[1], b[1])); }
static inline D maximum(const D& a, const D& b) { return D(maximum(a[0], b[0]), maximum(a[1], b[1])); }
#endif

// -- masks ---------------------------------------------------------------------------------------------------------------

// by instructions that take the comparison as a number, which AVX-512 and AVX2 share
#define LANES_COMPARISONS                                                                       \
  LANES_COMPARE(gt, _CMP_GT_OQ) LANES_COMPARE(lt, _CMP_LT_OQ) LANES_COMPARE(ge, _CMP_GE_OQ)     \
  LANES_COMPARE(le, _CMP_LE_OQ) LANES_COMPARE(eq, _CMP_EQ_OQ) LANES_COMPARE(ne, _CMP_NEQ_UQ)

#if defined(CPU_CAPABILITY_AVX512)
#ifdef LANES_MIXED
using M = __mmask16;
#define LANES_COMPARE(name, code)                                                                       \
  static inline M name(const F& a, const F& b) { return _mm512_cmp_ps_mask(a, b, code); }               \
  static inline M name(const D& a, const D& b) {                                                        \
    return M(_mm512_cmp_pd_mask(a[0], b[0], code)) | M(_mm512_cmp_pd_mask(a[1], b[1], code) << 8);      \
  }
static inline F where(M m, const F& a, const F& b) { return _mm512_mask_blend_ps(m, b, a); }
static inline D where(M m, const D& a, const D& b) {
  return D(V(_mm512_mask_blend_pd(__mmask8(m), b[0], a[0])), V(_mm512_mask_blend_pd(__mmask8(m >> 8), b[1], a[1])));
}
#else
using M = __mmask8;
#define LANES_COMPARE(name, code) \
  static inline M name(const D& a, const D& b) { return _mm512_cmp_pd_mask(a, b, code); }
static inline D where(M m, const D& a, const D& b) { return _mm512_mask_blend_pd(m, b, a); }
#endif
LANES_COMPARISONS
static inline M both(M a, M b) { return a & b; }
static inline M either(M a, M b) { return a | b; }
static inline M differ(M a, M b) { return a ^ b; }
static inline M opposite(M a) { return M(~a); }
static inline bool any(M m) { return m != 0; }
static inline M constant(bool b) { return b ? M(~M(0)) : M(0); }
#elif defined(CPU_CAPABILITY_AVX2)
#ifdef LANES_MIXED
struct M {
  __m256 bits{};
};
// the mask of two registers of doubles, whose lanes are twice as wide
static inline M narrowed(__m256d low, __m256d high) {
  const __m256i even = _mm256_setr_epi32(0, 2, 4, 6, 0, 2, 4, 6);
  const __m256 a = _mm256_permutevar8x32_ps(_mm256_castpd_ps(low), even);
  const __m256 b = _mm256_permutevar8x32_ps(_mm256_castpd_ps(high), even);
  return {_mm256_blend_ps(a, b, 0xF0)};
}
static inline __m256d widened(__m128 half) { return _mm256_castsi256_pd(_mm256_cvtepi32_epi64(_mm_castps_si128(half))); }
#define LANES_COMPARE(name, code)                                                                       \
  static inline M name(const F& a, const F& b) { return {_mm256_cmp_ps(a, b, code)}; }                  \
  static inline M name(const D& a, const D& b) {                                                        \
    return narrowed(_mm256_cmp_pd(a[0], b[0], code), _mm256_cmp_pd(a[1], b[1], code));                  \
  }
static inline F where(const M& m, const F& a, const F& b) { return _mm256_blendv_ps(b, a, m.bits); }
static inline D where(const M& m, const D& a, const D& b) {
  const __m256d low = widened(_mm256_castps256_ps128(m.bits)), high = widened(_mm256_extractf128_ps(m.bits, 1));
  return D(V(_mm256_blendv_pd(b[0], a[0], low)), V(_mm256_blendv_pd(b[1], a[1], high)));
}
#define LANES_BITS(name) _mm256_##name##_ps
#define LANES_AS_BITS _mm256_castsi256_ps
#else
struct M {
  __m256d bits{};
};
#define LANES_COMPARE(name, code) \
  static inline M name(const D& a, const D& b) { return {_mm256_cmp_pd(a, b, code)}; }
static inline D where(const M& m, const D& a, const D& b) { return _mm256_blendv_pd(b, a, m.bits); }
#define LANES_BITS(name) _mm256_##name##_pd
#define LANES_AS_BITS _mm256_castsi256_pd
#endif
LANES_COMPARISONS
static inline M constant(bool b) { return {LANES_AS_BITS(_mm256_set1_epi32(b ? -1 : 0))}; }
static inline M both(const M& a, const M& b) { return {LANES_BITS(and)(a.bits, b.bits)}; }
static inline M either(const M& a, const M& b) { return {LANES_BITS(or)(a.bits, b.bits)}; }
static inline M differ(const M& a, const M& b) { return {LANES_BITS(xor)(a.bits, b.bits)}; }
static inline M opposite(const M& a) { return differ(a, constant(true)); }
static inline bool any(const M& m) { return LANES_BITS(movemask)(m.bits) != 0; }
#else
#ifdef LANES_MIXED
using M = VecMask<float, 1>;
static inline M as_mask(const F& x) { return M(x); }
static inline F where(const M& m, const F& a, const F& b) { return F::blendv(b, a, m); }
static inline D where(const M& m, const D& a, const D& b) {
  const VectorizedN<double, 2> wide = m.template cast<double, 2>();
  return D(V::blendv(b.low, a.low, wide[0]), V::blendv(b.high, a.high, wide[1]));
}
#else
using M = VecMask<double, 1>;
static inline M as_mask(const D& x) { return M(x); }
static inline D where(const M& m, const D& a, const D& b) { return D::blendv(b, a, m); }
#endif
#ifdef LANES_MIXED
#define LANES_COMPARE_PAIRS(name, code)                                         \
  static inline M name(const D& a, const D& b) {                                \
    const VectorizedN<double, 2> both(a.low code b.low, a.high code b.high);    \
    return VecMask<double, 2>(both).template cast<float, 1>();                  \
  }
#else
#define LANES_COMPARE_PAIRS(name, code)
#endif
#define LANES_COMPARE(name, code)                                               \
  template <typename T>                                                         \
  static inline M name(const T& a, const T& b) { return as_mask(a code b); }    \
  LANES_COMPARE_PAIRS(name, code)
LANES_COMPARE(gt, >)
LANES_COMPARE(lt, <)
LANES_COMPARE(ge, >=)
LANES_COMPARE(le, <=)
LANES_COMPARE(eq, ==)
LANES_COMPARE(ne, !=)
static inline M both(const M& a, const M& b) { return a & b; }
static inline M either(const M& a, const M& b) { return a | b; }
static inline M differ(const M& a, const M& b) { return a ^ b; }
static inline M opposite(const M& a) { return ~a; }
static inline bool any(const M& m) { return !m.all_zero(); }
static inline M constant(bool b) { return M::from(b); }
#endif
static inline M where(const M& m, const M& a, const M& b) { return either(both(m, a), both(opposite(m), b)); }

// -- numbers -------------------------------------------------------------------------------------------------------------

template <typename T>
static inline T sign(const T& x) {
  const T zero(0);
  return where(gt(x, zero), T(1), where(lt(x, zero), T(-1), zero));
}

template <typename T>
static inline void load(D& to, const T& lane) {
  alignas(64) double buffer[W];
  for (int l = 0; l < W; ++l) buffer[l] = lane(l);
  to = D::loadu(buffer);
}
#ifdef LANES_MIXED
template <typename T>
static inline void load(F& to, const T& lane) {
  alignas(64) float buffer[W];
  for (int l = 0; l < W; ++l) buffer[l] = float(lane(l));
  to = F::loadu(buffer);
}
#if defined(CPU_CAPABILITY_AVX512)
static inline D widen(const F& x) {
  return D(V(_mm512_cvtps_pd(_mm512_castps512_ps256(x))), V(_mm512_cvtps_pd(_mm512_extractf32x8_ps(x, 1))));
}
static inline F narrow(const D& x) {
  return _mm512_insertf32x8(_mm512_castps256_ps512(_mm512_cvtpd_ps(x[0])), _mm512_cvtpd_ps(x[1]), 1);
}
#elif defined(CPU_CAPABILITY_AVX2)
static inline D widen(const F& x) {
  return D(V(_mm256_cvtps_pd(_mm256_castps256_ps128(x))), V(_mm256_cvtps_pd(_mm256_extractf128_ps(x, 1))));
}
static inline F narrow(const D& x) { return _mm256_set_m128(_mm256_cvtpd_ps(x[1]), _mm256_cvtpd_ps(x[0])); }
#else
static inline D widen(const F& x) {
  const VectorizedN<double, 2> wide = convert<double, 2, float, 1>(x);
  return D(wide[0], wide[1]);
}
static inline F narrow(const D& x) { return convert<float, 1, double, 2>(VectorizedN<double, 2>(x.low, x.high)); }
#endif
#endif
}  // namespace lanes
