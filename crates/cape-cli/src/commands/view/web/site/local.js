// A model in the page: the same messages as with the server, answered by a worker.

import { glb } from "./glb.js";
import { encodeMesh } from "./mesh_file.js";

/// What is shown, and the connection to it. `site` is the model as it was exported, `work` the function
/// that is the worker: as text, since pages that are opened as files may not load workers.
export async function openModel({ scene, tables, parts }, work) {
  const source = URL.createObjectURL(new Blob([`(${work})()`], { type: "text/javascript" }));
  const worker = new Worker(source);
  const { faces } = await new Promise((resolve, reject) => {
    worker.onmessage = ({ data }) => (data.error ? reject(new Error(data.error)) : resolve(data));
    worker.onerror = event => reject(new Error(event.message || "the model cannot be started"));
    worker.postMessage({ tables, parts });
  });
  URL.revokeObjectURL(source);
  const socket = new WorkerSocket(worker);
  return {
    subject: scene,
    faces,
    connect: () => socket.opened(),
    async download(format, question, layers) {
      if (format === "glb") {
        const figure = await socket.figure(question);
        return new Blob(glb({ ...figure, names: scene.model.joints }, faces));
      }
      const layer = layers.find(({ kind }) => kind === "clothed") ?? layers[0];
      return encodeMesh(format, layer, faces);
    },
  };
}

/// A worker with the interface of a WebSocket, as far as the link needs it.
class WorkerSocket {
  readyState = WebSocket.OPEN;
  onopen = null;
  onmessage = null;
  onclose = null;
  #worker;
  #figures = [];

  constructor(worker) {
    this.#worker = worker;
    worker.onmessage = ({ data }) => {
      if (typeof data === "string" || data instanceof ArrayBuffer) this.onmessage({ data });
      else this.#figures.shift()(data);
    };
    worker.onerror = null;
  }

  /// The socket, which tells soon that it is open.
  opened() {
    queueMicrotask(() => this.onopen());
    return this;
  }

  send(text) {
    this.#worker.postMessage(text);
  }

  /// What glTF stores of the clothed body of a picture.
  async figure(question) {
    const answer = new Promise(resolve => this.#figures.push(resolve));
    this.#worker.postMessage({ figure: question });
    const { error, ...figure } = await answer;
    if (error) throw new Error(error);
    return figure;
  }
}
