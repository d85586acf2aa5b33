// The server that computes other futures while the page is open; see bsk_torch/viewer/server.py.

/** Requests to `address`; the token of the page's own address goes along. */
export class Live {
  constructor(address) {
    this.address = address;
    this.query = window.location.search;
  }

  /** The recording of all flights so far, as bytes. */
  async recording() {
    return this.#bytes(await this.#answer("recording"));
  }

  /** The value of every action of a decision: {action_value, how}. */
  async values(track, decision) {
    return (await this.#answer("values", { track, decision })).json();
  }

  /** The recording with one more flight, which takes another action at a decision. */
  async branch(track, decision, action) {
    return this.#bytes(await this.#answer("branch", { track, decision, action }));
  }

  /** The recording with another episode; without a seed, the next one. */
  async episode(seed) {
    return this.#bytes(await this.#answer("episode", { seed }));
  }

  async #bytes(answer) {
    return new Uint8Array(await answer.arrayBuffer());
  }

  async #answer(name, body) {
    const options = body && { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
    let answer;
    try {
      answer = await fetch(`${this.address}/${name}${this.query}`, options);
    } catch {
      throw new Error("The server does not answer; start bsk-torch view again.");
    }
    if (answer.ok) return answer;
    const { error } = await answer.json().catch(() => ({}));
    throw new Error(error ?? `The server answers with the status ${answer.status}.`);
  }
}
