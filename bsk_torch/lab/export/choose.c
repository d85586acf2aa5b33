
/* the first of the largest logits among legal actions; -1 if none is legal */
static int choose(const float *logits, const unsigned char *legal)
{
    int best = -1;
    for (int a = 0; a < BSK_POLICY_ACTIONS; ++a) {
        if (legal[a] && (best < 0 || logits[a] > logits[best])) {
            best = a;
        }
    }
    return best;
}
