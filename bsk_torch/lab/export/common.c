#include <float.h>
#include <math.h>
#include <stddef.h>

/* y = W x + b with W stored as [inputs][outputs], so that compilers vectorize the inner loop without reordering sums */
static void dense(const float *weight, const float *bias, const float *x, int inputs, int outputs, float *y)
{
    for (int j = 0; j < outputs; ++j) {
        y[j] = bias[j];
    }
    for (int i = 0; i < inputs; ++i) {
        const float *row = weight + (size_t)i * (size_t)outputs;
        for (int j = 0; j < outputs; ++j) {
            y[j] += x[i] * row[j];
        }
    }
}

/* mean 0 and deviation 1 of sign(x) log(1 + |x|), clipped; returns 0 if a number is not finite */
static int standardize(const float *x, int n, const float *mean, const float *deviation, float *y)
{
    for (int i = 0; i < n; ++i) {
        if (!(fabsf(x[i]) <= FLT_MAX)) {
            return 0;
        }
        const float z = (copysignf(log1pf(fabsf(x[i])), x[i]) - mean[i]) / deviation[i];
        y[i] = z < -LARGEST ? -LARGEST : z > LARGEST ? LARGEST : z;
    }
    return 1;
}
