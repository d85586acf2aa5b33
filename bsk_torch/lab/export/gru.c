
static float logistic(float x)
{
    return 1.0f / (1.0f + expf(-x));
}

/* replaces the memory; returns 0, and leaves it, for numbers that are not finite */
static int network(const float *observation, float *memory, float *out)
{
    float x[2][WIDTH], now[3 * BSK_POLICY_MEMORY], before[3 * BSK_POLICY_MEMORY];
    if (!standardize(observation, BSK_POLICY_OBSERVED, own_mean, own_deviation, x[0])) {
        return 0;
    }
    for (int j = 0; j < BSK_POLICY_MEMORY; ++j) {
        if (!(fabsf(memory[j]) <= FLT_MAX)) {
            return 0;
        }
    }
    for (int k = 0; k < LAYERS; ++k) {
        float *y = x[(k + 1) % 2];
        dense(weights[k], biases[k], x[k % 2], sizes[k], sizes[k + 1], y);
        squash(y, sizes[k + 1]);
    }
    dense(now_weight, now_bias, x[LAYERS % 2], sizes[LAYERS], 3 * BSK_POLICY_MEMORY, now);
    dense(before_weight, before_bias, memory, BSK_POLICY_MEMORY, 3 * BSK_POLICY_MEMORY, before);
    for (int j = 0; j < BSK_POLICY_MEMORY; ++j) {
        const float reset = logistic(now[j] + before[j]);
        const float update = logistic(now[BSK_POLICY_MEMORY + j] + before[BSK_POLICY_MEMORY + j]);
        const float fresh = tanhf(now[2 * BSK_POLICY_MEMORY + j] + reset * before[2 * BSK_POLICY_MEMORY + j]);
        memory[j] = (memory[j] - fresh) * update + fresh;
    }
    dense(head_weight, head_bias, memory, BSK_POLICY_MEMORY, BSK_POLICY_OUT, out);
    return 1;
}
