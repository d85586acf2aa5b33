
/* the hyperbolic tangent, as 2 / (1 + exp(-2 x)) - 1 */
static void squash(float *x, int n)
{
    for (int i = 0; i < n; ++i) {
        x[i] = 2.0f / (1.0f + expf(-2.0f * x[i])) - 1.0f;
    }
}
