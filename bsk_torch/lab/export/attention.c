
static float tokens[1 + ROWS][WIDTH], query_key_value[1 + ROWS][3 * WIDTH]; /* working memory: calls must not overlap */

static void normalize(const float *x, const float *weight, const float *bias, float *y)
{
    float mean = 0.0f, variance = 0.0f;
    for (int j = 0; j < WIDTH; ++j) {
        mean += x[j] / WIDTH;
    }
    for (int j = 0; j < WIDTH; ++j) {
        variance += (x[j] - mean) * (x[j] - mean) / WIDTH;
    }
    const float scale = 1.0f / sqrtf(variance + EPSILON);
    for (int j = 0; j < WIDTH; ++j) {
        y[j] = (x[j] - mean) * scale * weight[j] + bias[j];
    }
}

static void rectify(float *x)
{
    for (int j = 0; j < WIDTH; ++j) {
        x[j] = x[j] > 0.0f ? x[j] : 0.0f;
    }
}

static void add(const float *x, float *y)
{
    for (int j = 0; j < WIDTH; ++j) {
        y[j] += x[j];
    }
}

/* what one token takes from all existing ones, by one head */
static void attend(const float *exists, int token, int head, float *attended)
{
    const int size = WIDTH / HEADS;
    const float *query = query_key_value[token] + head * size;
    float score[1 + ROWS], largest = -FLT_MAX, sum = 0.0f;
    for (int u = 0; u <= ROWS; ++u) {
        const float *key = query_key_value[u] + WIDTH + head * size;
        score[u] = 0.0f;
        if (u == 0 || exists[u - 1] != 0.0f) {
            for (int j = 0; j < size; ++j) {
                score[u] += query[j] * key[j];
            }
            score[u] /= sqrtf((float)size);
            largest = score[u] > largest ? score[u] : largest;
        }
    }
    for (int j = 0; j < size; ++j) {
        attended[j] = 0.0f;
    }
    for (int u = 0; u <= ROWS; ++u) {
        if (u == 0 || exists[u - 1] != 0.0f) {
            const float *value = query_key_value[u] + 2 * WIDTH + head * size;
            const float share = expf(score[u] - largest);
            sum += share;
            for (int j = 0; j < size; ++j) {
                attended[j] += share * value[j];
            }
        }
    }
    for (int j = 0; j < size; ++j) {
        attended[j] /= sum;
    }
}

static void block(const float *const *table, const float *exists)
{
    float x[WIDTH], y[WIDTH];
    for (int t = 0; t <= ROWS; ++t) {
        if (t == 0 || exists[t - 1] != 0.0f) {
            normalize(tokens[t], table[0], table[1], x);
            dense(table[2], table[3], x, WIDTH, 3 * WIDTH, query_key_value[t]);
        }
    }
    for (int t = 0; t <= ROWS; ++t) {
        if (t == 0 || exists[t - 1] != 0.0f) {
            for (int head = 0; head < HEADS; ++head) {
                attend(exists, t, head, x + head * (WIDTH / HEADS));
            }
            dense(table[4], table[5], x, WIDTH, WIDTH, y);
            add(y, tokens[t]);
            normalize(tokens[t], table[6], table[7], x);
            dense(table[8], table[9], x, WIDTH, WIDTH, y);
            rectify(y);
            dense(table[10], table[11], y, WIDTH, WIDTH, x);
            add(x, tokens[t]);
        }
    }
}

/* returns 0 for numbers that are not finite */
static int network(const float *observation, float *logits)
{
    const float *rows = observation + OWN, *exists = rows + ROWS * FEATURES;
    float own[OWN], row[FEATURES], context[WIDTH], x[WIDTH], others[OTHERS + 1];
    if (!standardize(observation, OWN, own_mean, own_deviation, own)) {
        return 0;
    }
    dense(context_weight, context_bias, own, OWN, WIDTH, context);
    dense(own_weight, own_bias, own, OWN, WIDTH, tokens[0]);
    for (int k = 0; k < ROWS; ++k) {
        if (exists[k] != 0.0f) {
            if (!standardize(rows + k * FEATURES, FEATURES, rows_mean, rows_deviation, row)) {
                return 0;
            }
            dense(row_weight, row_bias, row, FEATURES, WIDTH, x);
            add(context, x);
            rectify(x);
            dense(mix_weight, mix_bias, x, WIDTH, WIDTH, tokens[1 + k]);
        }
    }
    for (int b = 0; b < BLOCKS; ++b) {
        block(blocks[b], exists);
    }
    normalize(tokens[0], norm_weight, norm_bias, x);
    dense(other_weight, other_bias, x, WIDTH, OTHERS, others);
    for (int a = 0; a < BSK_POLICY_ACTIONS; ++a) {
        const int k = a - FIRST;
        if (k < 0) {
            logits[a] = others[a];
        } else if (k >= IMAGES) {
            logits[a] = others[a - IMAGES];
        } else if (exists[k] == 0.0f) {
            logits[a] = LEAST;
        } else {
            normalize(tokens[1 + k], norm_weight, norm_bias, x);
            dense(image_weight, image_bias, x, WIDTH, 1, logits + a);
        }
    }
    return 1;
}
