
/* returns 0 for numbers that are not finite */
static int network(const float *observation, float *out)
{
    float x[2][WIDTH];
    if (!standardize(observation, BSK_POLICY_OBSERVED, own_mean, own_deviation, x[0])) {
        return 0;
    }
    for (int k = 0; k < LAYERS; ++k) {
        float *y = k + 1 < LAYERS ? x[(k + 1) % 2] : out;
        dense(weights[k], biases[k], x[k % 2], sizes[k], sizes[k + 1], y);
        if (k + 1 < LAYERS) {
            squash(y, sizes[k + 1]);
        }
    }
    return 1;
}
