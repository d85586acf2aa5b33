// States between two stored times. Times in s, positions in m, attitudes as MRPs of B relative to N.

/** Index k of the interval [times[k], times[k + 1]] that holds t; the first or last one outside of the flight. */
export function interval(times, t) {
  let low = 0;
  let high = times.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle;
    else high = middle;
  }
  return low;
}

/** Number of sorted times that are not later than t. */
export function countUntil(times, t) {
  let low = 0;
  let high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle + 1;
    else high = middle;
  }
  return low;
}

/**
 * Cubic Hermite interpolation of n vectors between the rows k and k + 1 of r and v, [K, n, 3].
 * Writes positions to `position` and the derivatives of the same curve to `velocity`, both [n, 3].
 */
export function hermite(times, r, v, n, t, position, velocity) {
  const k = interval(times, t);
  const last = Math.min(k + 1, times.length - 1);
  const h = times[last] - times[k];
  const a = k * n * 3;
  const b = last * n * 3;
  if (h <= 0) {
    for (let j = 0; j < n * 3; j++) {
      position[j] = r[a + j];
      velocity[j] = v[a + j];
    }
    return;
  }
  const s = Math.min(Math.max((t - times[k]) / h, 0), 1);
  const q = 1 - s;
  const r0 = (1 + 2 * s) * q * q;
  const r1 = s * s * (3 - 2 * s);
  const v0 = s * q * q * h;
  const v1 = -s * s * q * h;
  const d = (6 * s * q) / h;
  const d0 = q * (1 - 3 * s);
  const d1 = s * (3 * s - 2);
  for (let j = 0; j < n * 3; j++) {
    position[j] = r0 * r[a + j] + v0 * v[a + j] + r1 * r[b + j] + v1 * v[b + j];
    velocity[j] = d * (r[b + j] - r[a + j]) + d0 * v[a + j] + d1 * v[b + j];
  }
}

/** Linear interpolation of row j of `values`, [K, width]; NaN where either neighbor is. */
export function linear(times, values, width, j, t) {
  if (!times.length) return NaN;
  const k = interval(times, t);
  const last = Math.min(k + 1, times.length - 1);
  const h = times[last] - times[k];
  const s = h > 0 ? Math.min(Math.max((t - times[k]) / h, 0), 1) : 0;
  const a = values[k * width + j];
  const b = values[last * width + j];
  return s === 0 ? a : s === 1 ? b : a + (b - a) * s;
}

/** Unit quaternion (x, y, z, w) that turns components in B into components in N, of an MRP (Schaub and Junkins). */
export function quaternionOfMrp(sx, sy, sz, out) {
  const square = sx * sx + sy * sy + sz * sz;
  const scale = 2 / (1 + square);
  return out.set(sx * scale, sy * scale, sz * scale, (1 - square) / (1 + square));
}

/** Interpolate between two MRPs along the shorter way: the second one is replaced by its shadow where that is nearer. */
export function mixMrp(a, b, s, out) {
  const square = b[0] * b[0] + b[1] * b[1] + b[2] * b[2];
  const turn = square > 0 ? -1 / square : 0;
  let direct = 0;
  let shadow = 0;
  for (let j = 0; j < 3; j++) {
    direct += (b[j] - a[j]) ** 2;
    shadow += (b[j] * turn - a[j]) ** 2;
  }
  const factor = turn !== 0 && shadow < direct ? turn : 1;
  for (let j = 0; j < 3; j++) out[j] = a[j] + (b[j] * factor - a[j]) * s;
}

/** Direction cosines of P relative to N at t, row-major: the Earth turns about P's third axis at a constant rate, rad/s. */
export function earthAttitude(PN0, rate, t) {
  const [a, b, c, d, e, f, ...axis] = PN0;
  const [cos, sin] = [Math.cos(rate * t), Math.sin(rate * t)];
  return [cos * a + sin * d, cos * b + sin * e, cos * c + sin * f, cos * d - sin * a, cos * e - sin * b, cos * f - sin * c, ...axis];
}

/** `array` if it has this length, otherwise a new one. */
export function sized(array, length) {
  return array?.length === length ? array : new Float64Array(length);
}
