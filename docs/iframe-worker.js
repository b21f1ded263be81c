/* The search of pages that are opened as files. Browsers refuse a Worker there, so a hidden frame of this page stands in
 * for it: it runs the worker's script, whose messages go to this page and back.
 */
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      const frame = document.createElement("iframe")
      frame.hidden = true
      document.body.appendChild(frame)
      const inside = frame.contentWindow
      // What a worker's script calls: answers go to the page, and other scripts are loaded one after the other.
      inside.postMessage = data => this.dispatchEvent(new MessageEvent("message", { data }))
      inside.importScripts = (...urls) => urls.reduce(
        (before, next) => before.then(() => new Promise((done, failed) => load(next, done, failed))),
        Promise.resolve())
      const load = (source, done, failed) => {
        const script = inside.document.createElement("script")
        Object.assign(script, { src: source, onload: done, onerror: failed })
        inside.document.head.appendChild(script)
      }
      this.ready = new Promise((done, failed) => load(String(url), done, failed))
      this.inside = inside
    }
    postMessage(data) {
      this.ready.then(() => this.inside.dispatchEvent(new MessageEvent("message", { data })))
    }
    terminate() {
      this.inside.frameElement.remove()
    }
  }
}
