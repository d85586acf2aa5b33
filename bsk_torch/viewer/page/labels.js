// Text over drawings, such that no two overlap: who comes first has the place.

/** A name that fits, with an ellipsis where it does not. */
export function shorten(text, most = 24) {
  return text.length > most ? `${text.slice(0, most - 1)}…` : text;
}

export class Labels {
  constructor(pen, width, height) {
    Object.assign(this, { pen, width, height, taken: [] });
  }

  /** Keep a box, CSS pixels, free of labels. */
  reserve(x, y, half) {
    this.taken.push([x - half, y - half, x + half, y + half]);
  }

  /** Write to the upper right of a point, or to its left where the edge is near; strong labels are always written. */
  write(text, x, y, { strong = false, color = strong ? "#FFFFFF" : "#C4D0E0", aside = 12, above = 11, edge = this.width } = {}) {
    const { pen } = this;
    pen.font = `${strong ? 600 : 400} 12px system-ui, sans-serif`;
    pen.textAlign = "left";
    pen.textBaseline = "middle";
    const width = pen.measureText(text).width;
    const left = x + aside + width > edge - 4 ? Math.max(x - aside - width, 2) : x + aside;
    const line = Math.min(Math.max(y - above, 9), this.height - 9);
    const box = [left - 2, line - 8, left + width + 2, line + 8];
    const hit = (other) => box[0] < other[2] && other[0] < box[2] && box[1] < other[3] && other[1] < box[3];
    if (!strong && this.taken.some(hit)) return;
    this.taken.push(box);
    pen.lineWidth = 3;
    pen.lineJoin = "round";
    pen.strokeStyle = "rgba(6, 10, 20, 0.75)";
    pen.strokeText(text, left, line);
    pen.fillStyle = color;
    pen.fillText(text, left, line);
  }
}
