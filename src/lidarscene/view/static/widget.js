// Widget of a notebook: the page in a frame, whose requests go to Python and whose blobs come back.

function render({ model, el }) {
  const frame = document.createElement("iframe");
  Object.assign(frame, { srcdoc: model.get("page"), height: model.get("height_px"), title: "lidarscene" });
  Object.assign(frame.style, { width: "100%", border: 0 });
  const ports = new Map();
  const ask = ({ source, data, ports: [port] }) => {
    if (source !== frame.contentWindow || !data?.lidarscene || !port) return;
    const number = crypto.getRandomValues(new Uint32Array(2)).join("-");
    ports.set(number, port);
    model.send({ number, name: data.lidarscene, settings: data.settings });
  };
  const answer = ({ number, error }, buffers) => {
    // Views of one model hear the answers to each other's questions.
    const port = ports.get(number);
    if (!port) return;
    ports.delete(number);
    const bytes = buffers?.[0];
    const buffer = bytes && bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
    port.postMessage({ error, buffer });
  };
  addEventListener("message", ask);
  model.on("msg:custom", answer);
  el.append(frame);
  return () => {
    removeEventListener("message", ask);
    model.off("msg:custom", answer);
  };
}

export default { render };
