// Blobs: a name in; header and typed arrays out, from this page or from the server. blob.py describes the form.

const TYPES = { float32: Float32Array, uint8: Uint8Array, int32: Int32Array, uint32: Uint32Array };

async function held(element) {
  const text = atob(element.textContent);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

// Inside of a notebook's widget the page has no server: widget.js hands what it asks for to Python.
function askedParent(name, settings) {
  return new Promise((resolve, reject) => {
    const { port1, port2 } = new MessageChannel();
    port1.onmessage = ({ data }) => (data.error ? reject(new Error(data.error)) : resolve(data.buffer));
    parent.postMessage({ lidarscene: name, settings }, "*", [port2]);
  });
}

// The error's message is the server's one line.
async function asked(name, settings) {
  if (location.protocol === "about:") return askedParent(name, settings);
  const options = settings && { method: "POST", body: JSON.stringify(settings) };
  let response;
  try {
    response = await fetch(name, options);
  } catch {
    throw new Error("lidarscene view has ended; start it again and reload this page");
  }
  if (!response.ok) throw new Error(await response.text());
  return response.arrayBuffer();
}

async function blob(name, settings) {
  const element = document.getElementById(`blob-${name}`);
  const buffer = element ? await held(element) : await asked(name, settings);
  const end = 4 + new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, end - 4)));
  const arrays = {};
  for (const [key, place] of Object.entries(header.arrays)) {
    arrays[key] = new TYPES[place.type](buffer, end + place.start, place.count);
  }
  return { ...header, arrays };
}
