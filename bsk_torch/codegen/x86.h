// Registers of AVX-512 and AVX2 as values: what simd.h needs of at::vec's vectors, by the same instructions and the same
// functions of SLEEF. at::vec would do, but half of the time in which a small kernel is compiled passes with its headers.
#pragma once
#include <immintrin.h>
#include <sleef.h>

namespace lanes {

#define LANES_METHOD(Name, name, value) \
  Name name() const { return value; }
#define LANES_SLEEF(Name, name, function) LANES_METHOD(Name, name, function(values))
#define LANES_SLEEF_PAIR(Name, name, function) \
  Name name(const Name& b) const { return function(values, b.values); }
#define LANES_OPERATOR(Name, op, instruction) \
  static inline Name operator op(const Name& a, const Name& b) { return instruction(a.values, b.values); }

// A register of numbers: mm begins the names of instructions, type ends them; lanes ends those of SLEEF's functions, of which
// sine and cosine have the accuracy wave, in tenths of a unit of the last place.
#define LANES_REGISTER(Name, Number, Register, mm, type, toward, lanes, wave)                                \
  struct Name {                                                                                              \
    Register values;                                                                                         \
    Name() : values(mm##_setzero_##type()) {}                                                                \
    Name(Number x) : values(mm##_set1_##type(x)) {}                                                          \
    Name(Register x) : values(x) {}                                                                          \
    operator Register() const { return values; }                                                             \
    static constexpr int size() { return sizeof(Register) / sizeof(Number); }                                \
    static Name loadu(const Number* from) { return mm##_loadu_##type(from); }                                \
    void store(Number* to) const { mm##_storeu_##type(to, values); }                                         \
    LANES_METHOD(Name, neg, mm##_xor_##type(mm##_set1_##type(Number(-0.0)), values))                         \
    LANES_METHOD(Name, abs, mm##_andnot_##type(mm##_set1_##type(Number(-0.0)), values))                      \
    LANES_METHOD(Name, sqrt, mm##_sqrt_##type(values))                                                       \
    LANES_METHOD(Name, floor, mm##_floor_##type(values))                                                     \
    LANES_METHOD(Name, ceil, mm##_ceil_##type(values))                                                       \
    LANES_METHOD(Name, round, mm##_##toward##_##type(values, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC)) \
    LANES_METHOD(Name, trunc, mm##_##toward##_##type(values, _MM_FROUND_TO_ZERO | _MM_FROUND_NO_EXC))        \
    LANES_SLEEF(Name, sin, Sleef_sin##lanes##wave)                                                           \
    LANES_SLEEF(Name, cos, Sleef_cos##lanes##wave)                                                           \
    LANES_SLEEF(Name, tan, Sleef_tan##lanes##_u10)                                                           \
    LANES_SLEEF(Name, asin, Sleef_asin##lanes##_u10)                                                         \
    LANES_SLEEF(Name, acos, Sleef_acos##lanes##_u10)                                                         \
    LANES_SLEEF(Name, atan, Sleef_atan##lanes##_u10)                                                         \
    LANES_SLEEF(Name, sinh, Sleef_sinh##lanes##_u10)                                                         \
    LANES_SLEEF(Name, cosh, Sleef_cosh##lanes##_u10)                                                         \
    LANES_SLEEF(Name, tanh, Sleef_tanh##lanes##_u10)                                                         \
    LANES_SLEEF(Name, exp, Sleef_exp##lanes##_u10)                                                           \
    LANES_SLEEF(Name, expm1, Sleef_expm1##lanes##_u10)                                                       \
    LANES_SLEEF(Name, log, Sleef_log##lanes##_u10)                                                           \
    LANES_SLEEF(Name, log2, Sleef_log2##lanes##_u10)                                                         \
    LANES_SLEEF(Name, log10, Sleef_log10##lanes##_u10)                                                       \
    LANES_SLEEF(Name, log1p, Sleef_log1p##lanes##_u10)                                                       \
    LANES_SLEEF_PAIR(Name, atan2, Sleef_atan2##lanes##_u10)                                                  \
    LANES_SLEEF_PAIR(Name, hypot, Sleef_hypot##lanes##_u05)                                                  \
    LANES_SLEEF_PAIR(Name, fmod, Sleef_fmod##lanes)                                                          \
  };                                                                                                         \
  LANES_OPERATOR(Name, +, mm##_add_##type)                                                                   \
  LANES_OPERATOR(Name, -, mm##_sub_##type)                                                                   \
  LANES_OPERATOR(Name, *, mm##_mul_##type)                                                                   \
  LANES_OPERATOR(Name, /, mm##_div_##type)

#if defined(CPU_CAPABILITY_AVX512)
LANES_REGISTER(V, double, __m512d, _mm512, pd, roundscale, d8, _u10)
LANES_REGISTER(F, float, __m512, _mm512, ps, roundscale, f16, _u35)
#else
LANES_REGISTER(V, double, __m256d, _mm256, pd, round, d4, _u10)
LANES_REGISTER(F, float, __m256, _mm256, ps, round, f8, _u35)
#endif

}  // namespace lanes
