/* Repeats the recorded decisions: how many agree, and the time of one. */
#include "policy.h"
#include "recorded.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#ifdef BSK_POLICY_MEMORY
static float memory[BSK_POLICY_MEMORY];

static int act(int k, float *out)
{
    memcpy(memory, before[k], sizeof memory);
    return bsk_policy_act(observation[k], mask[k], memory, out);
}
#else
static int act(int k, float *out)
{
    return bsk_policy_act(observation[k], mask[k], out);
}
#endif

int main(void)
{
    int agree = 0;
    double largest = 0.0;
    float out[BSK_POLICY_OUT];
    for (int k = 0; k < RECORDED; ++k) {
        int same = act(k, out) == action[k];
        for (int j = 0; j < BSK_POLICY_OUT; ++j) {
            const double apart = fabs((double)out[j] - (double)expected[k][j]) / (double)scale[j];
            largest = apart > largest ? apart : largest;
            same = same && apart <= (double)TOLERANCE;
        }
#ifdef BSK_POLICY_MEMORY
        for (int j = 0; j < BSK_POLICY_MEMORY; ++j) {
            const double apart = fabs((double)memory[j] - (double)after[k][j]);
            largest = apart > largest ? apart : largest;
            same = same && apart <= (double)TOLERANCE;
        }
#endif
        agree += same;
    }
    const clock_t start = clock();
    long calls = 0;
    while (clock() - start < CLOCKS_PER_SEC / 5) {
        for (int k = 0; k < RECORDED; ++k, ++calls) {
            (void)act(k, out);
        }
    }
    const double seconds = (double)(clock() - start) / CLOCKS_PER_SEC;
    printf("%d of %d recorded decisions agree, largest difference %.2g, ", agree, RECORDED, largest);
    printf("%.0f ns per decision\n", 1e9 * seconds / (double)calls);
    return agree == RECORDED ? 0 : 1;
}
