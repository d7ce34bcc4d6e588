// A model in the page: the same messages as with the server, answered by a worker.

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
  return {
    subject: scene,
    faces,
    connect: () => new WorkerSocket(worker),
    async download(format, question, layers) {
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

  constructor(worker) {
    this.#worker = worker;
    worker.onmessage = ({ data }) => this.onmessage({ data });
    worker.onerror = null;
    queueMicrotask(() => this.onopen());
  }

  send(text) {
    this.#worker.postMessage(text);
  }
}
