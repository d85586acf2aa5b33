// Colors that viewers with any kind of color vision tell apart (Okabe and Ito, 2008), and what they stand for.

export const ORANGE = "#E69F00";
export const SKY = "#56B4E9";
export const GREEN = "#1FB88A"; // their bluish green, lighter: read on dark space
export const YELLOW = "#F0E442";
export const BLUE = "#3D8FD1"; // their blue, lighter
export const VERMILION = "#E8702A"; // likewise
export const PURPLE = "#CC79A7";
export const GRAY = "#8A94A6";

const ACTIONS = [
  [/charg|sun/i, YELLOW],
  [/downlink|transmit/i, SKY],
  [/desat|momentum/i, PURPLE],
  [/broadcast|share|communicat/i, ORANGE],
  [/imag|scan|target|observe|photo|inspect/i, GREEN],
  [/drift|idle|nothing|wait|noop|none/i, GRAY],
];
const OTHERS = [BLUE, VERMILION, ORANGE, PURPLE, SKY, GREEN, YELLOW];

/** Color of an action: by what its label says, otherwise by its index; continuous actions have the index -1. */
export function actionColor(label, index) {
  if (index < 0) return ORANGE;
  const found = ACTIONS.find(([pattern]) => pattern.test(label));
  return found ? found[1] : OTHERS[index % OTHERS.length];
}

/** Colors of tracks drawn together: the first is the one shown. */
export const TRACKS = [ORANGE, SKY, PURPLE, GREEN, YELLOW, VERMILION, BLUE];

/** Red, green and blue, 0 to 1, of "#rrggbb". */
export function rgb(color) {
  const number = parseInt(color.slice(1), 16);
  return [(number >> 16) / 255, ((number >> 8) & 255) / 255, (number & 255) / 255];
}
