// The source of the viewer that the program is: a server.

async function load(name) {
  const answer = await fetch(name);
  if (!answer.ok) throw new Error(`${name} is not to be had (${answer.status}).`);
  return answer;
}

function connect() {
  const url = new URL("socket", location.href);
  url.protocol = url.protocol.replace("http", "ws");
  const socket = new WebSocket(url);
  socket.binaryType = "arraybuffer";
  return socket;
}

async function download(format, question) {
  const answer = await fetch("download", {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ format, ...question }),
  });
  if (!answer.ok) throw new Error(`${format} is not to be had: ${(await answer.text()) || answer.statusText}`);
  return answer.blob();
}

export async function openServer() {
  const [subject, faces] = await Promise.all([
    load("scene.json").then(answer => answer.json()),
    load("faces.bin").then(answer => answer.arrayBuffer()),
  ]);
  return { subject, faces: new Uint32Array(faces), connect, download };
}
