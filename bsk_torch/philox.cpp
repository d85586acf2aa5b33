// Uniform numbers of Philox4x32-10; called by rand.py, which says what they are and computes the same with NumPy.

#include <cstdint>

namespace {

struct Words {
    uint32_t c0, c1, c2, c3;
};

inline Words philox(Words c, uint32_t k0, uint32_t k1) {
    for (int round = 0; round < 10; ++round) {
        const uint64_t p0 = uint64_t(0xD2511F53u) * c.c0, p1 = uint64_t(0xCD9E8D57u) * c.c2;
        c = {uint32_t(p1 >> 32) ^ c.c1 ^ k0, uint32_t(p1), uint32_t(p0 >> 32) ^ c.c3 ^ k1, uint32_t(p0)};
        k0 += 0x9E3779B9u, k1 += 0xBB67AE85u;
    }
    return c;
}

inline double uniform(uint32_t high, uint32_t low) {
    return double(int64_t(high >> 5) * 67108864 + int64_t(low >> 6)) / 9007199254740992.0;
}

}  // namespace

extern "C" void run(
    int64_t rows, int64_t count, int64_t stream, int64_t high_words, const int64_t* seeds, const int64_t* envs,
    const int64_t* episodes, const int64_t* first_blocks, double* numbers) {
    for (int64_t row = 0; row < rows; ++row) {
        const uint64_t env = envs[row], episode = episodes[row];
        const uint32_t high_env = env >> 32, high_episode = episode >> 32;
        uint32_t k0 = uint64_t(seeds[row]), k1 = uint64_t(seeds[row]) >> 32;
        if (high_env | high_episode) {
            const Words key = philox({0, high_episode, high_env, uint32_t(high_words)}, k0, k1);
            k0 = key.c0, k1 = key.c1;
        }
        const uint32_t first = first_blocks ? first_blocks[row] : 0;
        double* to = numbers + row * count;
        for (int64_t number = 0; number < count; number += 2) {
            const Words word = philox({first + uint32_t(number / 2), uint32_t(episode), uint32_t(env), uint32_t(stream)}, k0, k1);
            to[number] = uniform(word.c0, word.c1);
            if (number + 1 < count) to[number + 1] = uniform(word.c2, word.c3);
        }
    }
}
