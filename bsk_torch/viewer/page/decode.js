// Reads the container that bsk_torch/recording/recording.py writes: a JSON header and plain arrays behind one gzip stream.

export const VERSION = 1;

const MAGIC = "BSKVIEW\n";
const PREAMBLE = 16; // bytes of the magic, of the version and of the length of the header
const VIEWS = { f4: Float32Array, f8: Float64Array, i2: Int16Array, i4: Int32Array, u1: Uint8Array };

/** What a user is told when a recording cannot be shown. */
export class UnreadableRecording extends Error {}

/** Decode a recording: {header, arrays: name -> {data, shape, scale}}, with values stored * scale. */
export async function decode(bytes) {
  const buffer = await gunzip(bytes);
  const text = new TextDecoder();
  if (text.decode(buffer.slice(0, MAGIC.length)) !== MAGIC) {
    throw new UnreadableRecording("This is no recording of bsk_torch's viewer: its first bytes differ.");
  }
  if (buffer.byteLength < PREAMBLE) throw cutOff();
  const preamble = new DataView(buffer, MAGIC.length);
  const version = preamble.getUint32(0, true);
  const length = preamble.getUint32(4, true);
  if (version !== VERSION) {
    throw new UnreadableRecording(
      `The recording has version ${version} of the format, and this page reads version ${VERSION}. ` +
        "Open it with the version of bsk_torch that wrote it, or record the flight again.",
    );
  }
  if (buffer.byteLength < PREAMBLE + length) throw cutOff();
  const header = JSON.parse(text.decode(new Uint8Array(buffer, PREAMBLE, length)), (_, value) => (typeof value === "string" ? visible(value) : value));
  const payload = PREAMBLE + length;
  if (buffer.byteLength < payload + header.payload_bytes) throw cutOff();
  const arrays = {};
  for (const [name, { dtype, shape, offset, scale }] of Object.entries(header.arrays)) {
    const size = shape.reduce((product, n) => product * n, 1);
    arrays[name] = { data: new VIEWS[dtype](buffer, payload + offset, size), shape, scale: scale ?? 1 };
  }
  return { header, arrays };
}

/** A text with hidden characters, such as those that change its direction, as escapes. */
function visible(text) {
  return text.replace(/[\p{Cc}\p{Cf}\p{Cs}\p{Zl}\p{Zp}]/gu, (c) => `\\u{${c.codePointAt(0).toString(16)}}`);
}

/** Bytes of the base64 text that page.py puts into the page. */
export function fromBase64(text) {
  const binary = atob(text.trim());
  const bytes = new Uint8Array(binary.length);
  for (let k = 0; k < binary.length; k++) bytes[k] = binary.charCodeAt(k);
  return bytes;
}

function cutOff() {
  return new UnreadableRecording("The recording is cut off: a part of the file is missing. Copy or export it again.");
}

async function gunzip(bytes) {
  if (bytes[0] !== 0x1f || bytes[1] !== 0x8b) {
    throw new UnreadableRecording("This is no recording of bsk_torch's viewer: it is not compressed with gzip.");
  }
  try {
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return await new Response(stream).arrayBuffer();
  } catch {
    throw cutOff();
  }
}
