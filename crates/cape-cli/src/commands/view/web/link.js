// The connection to the server, or to a worker in its place.

import { readAnswer } from "./answer.js";

const BACK_OFF = [0.5, 1, 2, 4, 8];
/// After this long a picture counts as dropped.
const PATIENCE = 20_000;

/// Asks for pictures, of which only the newest matters, and for other things, which all matter.
export class Link {
  #open;
  #handlers;
  #socket = null;
  #failures = 0;
  #lastId = 0;
  #wanted = null;
  #flying = null;
  #shown = 0;
  #questions = new Map();

  /// `open` returns a new WebSocket, or the like. `handlers` has `answer(layers, latency)`,
  /// `failure(message)`, `lost(seconds)`, `found()` and `settled()`, which is called whenever a picture
  /// has arrived or is not waited for any more.
  constructor(open, handlers) {
    this.#open = open;
    this.#handlers = handlers;
    this.#connect();
  }

  /// True if no picture is awaited.
  get idle() {
    return !this.#wanted && !this.#flying;
  }

  /// Asks for a picture, in place of any that has not been asked for yet.
  show(body) {
    this.#wanted = body;
    this.#flush();
  }

  /// Asks for something else.
  ask(body) {
    return new Promise((resolve, reject) => {
      if (this.#socket?.readyState !== WebSocket.OPEN) {
        reject(new Error("there is no connection"));
        return;
      }
      this.#questions.set(this.#send(body), { resolve, reject });
    });
  }

  #connect() {
    const socket = this.#open();
    socket.onopen = () => {
      if (this.#failures > 0) this.#handlers.found();
      this.#failures = 0;
      this.#flush();
    };
    socket.onmessage = ({ data }) => (typeof data === "string" ? this.#text(data) : this.#binary(data));
    socket.onclose = () => this.#closed();
    this.#socket = socket;
  }

  #closed() {
    const lost = this.#land();
    this.#wanted ??= lost;
    for (const { reject } of this.#questions.values()) reject(new Error("the connection was lost"));
    this.#questions.clear();
    const seconds = BACK_OFF[Math.min(this.#failures, BACK_OFF.length - 1)];
    this.#failures += 1;
    this.#handlers.lost(seconds);
    setTimeout(() => this.#connect(), seconds * 1000);
  }

  #send(body) {
    const id = ++this.#lastId;
    this.#socket.send(JSON.stringify({ id, ...body }));
    return id;
  }

  #flush() {
    if (!this.#wanted || this.#flying || this.#socket.readyState !== WebSocket.OPEN) return;
    const body = this.#wanted;
    this.#wanted = null;
    const id = this.#send(body);
    const timer = setTimeout(() => this.#done(), PATIENCE);
    this.#flying = { id, body, timer, since: performance.now() };
  }

  /// Takes the picture that is waited for off the list; returns its request.
  #land() {
    clearTimeout(this.#flying?.timer);
    const body = this.#flying?.body ?? null;
    this.#flying = null;
    return body;
  }

  #done() {
    this.#land();
    this.#flush();
    this.#handlers.settled();
  }

  #binary(buffer) {
    let answer;
    try {
      answer = readAnswer(buffer);
    } catch (error) {
      this.#handlers.failure(error.message);
      this.#done();
      return;
    }
    if (answer.id < this.#shown) return;
    this.#shown = answer.id;
    const expected = this.#flying?.id === answer.id;
    this.#handlers.answer(answer.layers, expected ? performance.now() - this.#flying.since : null);
    if (expected) this.#done();
  }

  #text(text) {
    const { id, error, ...answer } = JSON.parse(text);
    const question = this.#questions.get(id);
    if (question) {
      this.#questions.delete(id);
      if (error) question.reject(new Error(error));
      else question.resolve(answer);
    } else if (id === this.#flying?.id) {
      if (error) this.#handlers.failure(error);
      this.#done();
    }
  }
}
