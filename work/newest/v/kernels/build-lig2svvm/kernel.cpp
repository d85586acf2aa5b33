#include "simd.h"
using namespace lanes;

extern "C" int lanes_width() { return W; }

// Runs counts[i] ticks of row rows[i] for every i; rows come in blocks of W, padded with counts of zero. Row i of the tables is
// owner[i], or i without owners. Tick k of row i writes record k - 1 of row i of written. What ends a row early lowers its count.
extern "C" void run(int64_t blocks, int64_t threads, const int64_t* rows, int64_t* counts, int64_t n,
                    double* state, const double* shared, const double* own, const double* flags, int64_t modes,
                    const int64_t* mode, const int64_t* ticks, int64_t nanoseconds, const double* schedule,
                    double* written, int64_t stride,
                    const double* table_1, const double* starts_1, const int64_t* owner_1, int64_t records_1,
                    const double* table_2, const double* starts_2, const int64_t* owner_2, int64_t records_2) {
#pragma omp parallel for schedule(dynamic) num_threads(threads) if (threads > 1)
  for (int64_t block = 0; block < blocks; ++block) {
    const int64_t* row = rows + block * W;
    int64_t* count = counts + block * W;
    int64_t last = 0, next = INT64_MAX;
    for (int l = 0; l < W; ++l) {
      if (count[l] > last) last = count[l];
      if (count[l] > 0 && count[l] < next) next = count[l];
    }
    if (last == 0) continue;
    D ticks_start(0);
    if (ticks) load(ticks_start, [&](int l) { return double(ticks[row[l]]); });
    D state_0; load(state_0, [&](int l) { return state[0 * n + row[l]]; });

    D start_1(0), base_1(0), from_1(0), until_1(0);
    if (starts_1) load(start_1, [&](int l) { return starts_1[owner_1 ? owner_1[row[l]] : row[l]]; });
    D track_1_6;
    D track_1_7;
    D track_1_8;
    D track_1_9;
    D track_1_10;
    D track_1_11;
    D track_1_12;
    D track_1_13;
    D track_1_14;
    D track_1_15;
    D v41;
    D v42;
    D v200;
    D v201;
    D start_2(0), base_2(0), from_2(0), until_2(0);
    if (starts_2) load(start_2, [&](int l) { return starts_2[owner_2 ? owner_2[row[l]] : row[l]]; });
    D track_2_0;
    D track_2_1;
    D track_2_2;

    for (int64_t k = 1; k <= last; ++k) {
      const D ticks_now = ticks_start + D(double(k));
      const D time_now = state_0;
      const D elapsed_1 = time_now - start_1;
      if (k == 1 || any(either(lt(elapsed_1, from_1), ge(elapsed_1, until_1)))) {
        const D none(0), most(double(records_1 - 2)), spacing(3600.0), before(0.0);
        const D endless(std::numeric_limits<double>::infinity()), found = (elapsed_1 / spacing).floor() - before;
        // what is no number compares false and gets the first record
        const D first = where(ge(found, none), where(lt(found, most), found, most), none);
        base_1 = (first + before) * spacing;
        from_1 = where(gt(first, none), base_1, none - endless);
        until_1 = where(lt(first, most), base_1 + spacing, endless);
        alignas(64) double index[W];
        first.store(index);
        const double* record[W];
        for (int l = 0; l < W; ++l) {
          record[l] = table_1 + ((owner_1 ? owner_1[row[l]] : row[l]) * records_1 + int64_t(index[l])) * 16;
        }
        load(track_1_6, [&](int l) { return record[l][6]; });
        load(track_1_7, [&](int l) { return record[l][7]; });
        load(track_1_8, [&](int l) { return record[l][8]; });
        load(track_1_9, [&](int l) { return record[l][9]; });
        load(track_1_10, [&](int l) { return record[l][10]; });
        load(track_1_11, [&](int l) { return record[l][11]; });
        load(track_1_12, [&](int l) { return record[l][12]; });
        load(track_1_13, [&](int l) { return record[l][13]; });
        load(track_1_14, [&](int l) { return record[l][14]; });
        load(track_1_15, [&](int l) { return record[l][15]; });
        v41 = track_1_12 * D(-3.545123997161905e-12);
        v42 = track_1_15 * D(-3.545123997161905e-12);
        v200 = track_1_6.cos();
        v201 = track_1_6.sin();
      }
      const D tau_1 = elapsed_1 - base_1;
      const D elapsed_2 = time_now - start_2;
      if (k == 1 || any(either(lt(elapsed_2, from_2), ge(elapsed_2, until_2)))) {
        const D none(0), most(double(records_2 - 1)), spacing(30.0), before(0.0);
        const D endless(std::numeric_limits<double>::infinity()), found = (elapsed_2 / spacing).floor() - before;
        // what is no number compares false and gets the first record
        const D first = where(ge(found, none), where(lt(found, most), found, most), none);
        base_2 = (first + before) * spacing;
        from_2 = where(gt(first, none), base_2, none - endless);
        until_2 = where(lt(first, most), base_2 + spacing, endless);
        alignas(64) double index[W];
        first.store(index);
        const double* record[W];
        for (int l = 0; l < W; ++l) {
          record[l] = table_2 + ((owner_2 ? owner_2[row[l]] : row[l]) * records_2 + int64_t(index[l])) * 3;
        }
        load(track_2_0, [&](int l) { return record[l][0]; });
        load(track_2_1, [&](int l) { return record[l][1]; });
        load(track_2_2, [&](int l) { return record[l][2]; });

      }
      const D tau_2 = elapsed_2 - base_2;
      const D v5 = state_0 + D(30.0);
      const D v43 = D(3.0805523657085508e-12) * tau_1;
      const D v44 = v41 * tau_1;
      const D v45 = v42 * tau_1;
      const D v46 = track_1_13 * v44;
      const D v47 = track_1_14 * v44;
      const D v48 = track_1_15 * v44;
      const D v49 = track_1_7 - v46;
      const D v50 = track_1_8 - v47;
      const D v51 = track_1_9 - v48;
      const D v52 = track_1_10 * v45;
      const D v53 = track_1_11 * v45;
      const D v54 = track_1_12 * v45;
      const D v55 = v49 + v52;
      const D v56 = v50 + v53;
      const D v57 = v51 + v54;
      const D v58 = track_1_7 * v45;
      const D v59 = track_1_8 * v45;
      const D v60 = track_1_9 * v45;
      const D v61 = track_1_10 - v58;
      const D v62 = track_1_11 - v59;
      const D v63 = track_1_12 - v60;
      const D v64 = track_1_13 * v43;
      const D v65 = track_1_14 * v43;
      const D v66 = track_1_15 * v43;
      const D v67 = v61 + v64;
      const D v68 = v62 + v65;
      const D v69 = v63 + v66;
      const D v70 = track_1_10 * v43;
      const D v71 = track_1_11 * v43;
      const D v72 = track_1_12 * v43;
      const D v73 = track_1_13 - v70;
      const D v74 = track_1_14 - v71;
      const D v75 = track_1_15 - v72;
      const D v76 = track_1_7 * v44;
      const D v77 = track_1_8 * v44;
      const D v78 = track_1_9 * v44;
      const D v79 = v73 + v76;
      const D v80 = v74 + v77;
      const D v81 = v75 + v78;
      const D v150 = D(7.292115373194001e-05) * tau_1;
      const D v151 = v150 * v150;
      const D v154 = v151 * D(0.007575757575757576);
      const D v155 = D(1.0) - v154;
      const D v157 = v151 * D(0.00641025641025641);
      const D v158 = D(1.0) - v157;
      const D v159 = v155 * v151;
      const D v161 = v159 * D(0.011111111111111112);
      const D v162 = D(1.0) - v161;
      const D v163 = v158 * v151;
      const D v165 = v163 * D(0.00909090909090909);
      const D v166 = D(1.0) - v165;
      const D v167 = v162 * v151;
      const D v169 = v167 * D(0.017857142857142856);
      const D v170 = D(1.0) - v169;
      const D v171 = v166 * v151;
      const D v173 = v171 * D(0.013888888888888888);
      const D v174 = D(1.0) - v173;
      const D v175 = v170 * v151;
      const D v177 = v175 * D(0.03333333333333333);
      const D v178 = D(1.0) - v177;
      const D v179 = v174 * v151;
      const D v181 = v179 * D(0.023809523809523808);
      const D v182 = D(1.0) - v181;
      const D v183 = v178 * v151;
      const D v185 = v183 * D(0.08333333333333333);
      const D v186 = D(1.0) - v185;
      const D v187 = v182 * v151;
      const D v189 = v187 * D(0.05);
      const D v190 = D(1.0) - v189;
      const D v191 = v186 * v151;
      const D v193 = v191 * D(0.5);
      const D v194 = D(1.0) - v193;
      const D v195 = v190 * v151;
      const D v197 = v195 * D(0.16666666666666666);
      const D v198 = D(1.0) - v197;
      const D v199 = v198 * v150;
      const D v202 = v200 * v194;
      const D v203 = v201 * v199;
      const D v204 = v202 - v203;
      const D v205 = v201 * v194;
      const D v206 = v200 * v199;
      const D v207 = v205 + v206;
      const D v208 = v55 * track_2_0;
      const D v209 = v56 * track_2_1;
      const D v210 = v208 + v209;
      const D v211 = v57 * track_2_2;
      const D v212 = v210 + v211;
      const D v213 = v67 * track_2_0;
      const D v214 = v68 * track_2_1;
      const D v215 = v213 + v214;
      const D v216 = v69 * track_2_2;
      const D v217 = v215 + v216;
      const D v218 = v79 * track_2_0;
      const D v219 = v80 * track_2_1;
      const D v220 = v218 + v219;
      const D v221 = v81 * track_2_2;
      const D v222 = v220 + v221;
      const D v223 = v204 * v212;
      const D v224 = v207 * v217;
      const D v225 = v223 + v224;
      const D v226 = v204 * v217;
      const D v227 = v207 * v212;
      const D v228 = v226 - v227;

      {
        alignas(64) double out[3][W];
        v225.store(out[0]);
        v228.store(out[1]);
        v222.store(out[2]);
        for (int l = 0; l < W; ++l) {
          if (count[l] < k) continue;
          double* to = written + row[l] * stride + (k - 1) * 3;
          to[0] = out[0][l];
          to[1] = out[1][l];
          to[2] = out[2][l];
        }
      }
      if (k == next) {
        alignas(64) double out[1][W];
        v5.store(out[0]);
        next = INT64_MAX;
        for (int l = 0; l < W; ++l) {
          if (count[l] == k) {
            state[0 * n + row[l]] = out[0][l];
          } else if (count[l] > k && count[l] < next) {
            next = count[l];
          }
        }

      }
      const D new_0 = v5;
      state_0 = new_0;
    }
  }
}
