// The server that computes other futures while the page is open; see bsk_torch/viewer/server.py.

/** Requests to `address`; the token of the page's own address goes along. The server drops old flights, so it numbers all of them. */
export class Live {
  constructor(address) {
    this.address = address;
    this.token = new URLSearchParams(window.location.search).get("token") ?? "";
    this.numbers = []; // of the flights, in the order of the tracks of the last recording
  }

  /** The recording of all flights that are kept, as bytes. */
  async recording() {
    return this.#bytes(await this.#answer("recording"));
  }

  /** The value of every action of a decision: {action_value, how}. */
  async values(track, decision) {
    return (await this.#answer("values", { track: this.numbers[track], decision })).json();
  }

  /** The recording with one more flight, which takes another action at a decision. */
  async branch(track, decision, action) {
    return this.#bytes(await this.#answer("branch", { track: this.numbers[track], decision, action }));
  }

  /** The recording with another episode; without a seed, the next one. */
  async episode(seed) {
    return this.#bytes(await this.#answer("episode", { seed }));
  }

  async #bytes(answer) {
    this.numbers = answer.headers.get("X-Flights").split(",").map(Number);
    return new Uint8Array(await answer.arrayBuffer());
  }

  async #answer(name, body) {
    const options = { headers: { Authorization: `Bearer ${this.token}` } };
    if (body) Object.assign(options, { method: "POST", body: JSON.stringify(body) }).headers["Content-Type"] = "application/json";
    let answer;
    try {
      answer = await fetch(`${this.address}/${name}`, options);
    } catch {
      throw new Error("The server does not answer; start bsk-torch view again.");
    }
    if (answer.ok) return answer;
    const { error } = await answer.json().catch(() => ({}));
    throw new Error(error ?? `The server answers with the status ${answer.status}.`);
  }
}
