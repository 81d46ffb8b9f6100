// The search runs in a worker, which browsers refuse to pages that are opened from a folder. There its script runs in a
// hidden frame. The theme looks for the name IFrameWorker, and needs "message" events and postMessage only.
class IFrameWorker extends EventTarget {
  constructor(address) {
    super();
    const frame = document.createElement("iframe");
    frame.hidden = true;
    document.body.append(frame);
    const inner = frame.contentWindow;
    inner.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
    inner.importScripts = (...addresses) =>
      addresses.reduce((before, each) => before.then(() => added(inner.document, each)), Promise.resolve());
    this.inner = inner;
    this.ready = added(inner.document, address);
  }

  postMessage(data) {
    this.ready.then(() => this.inner.dispatchEvent(new this.inner.MessageEvent("message", { data })));
  }

  terminate() {
    this.inner.frameElement.remove();
  }
}

function added(page, address) {
  const script = page.createElement("script");
  script.src = address;
  return new Promise((resolve, reject) => {
    script.onload = resolve;
    script.onerror = () => reject(new Error(`${address} cannot be read`));
    page.body.append(script);
  });
}

if (location.protocol === "file:") {
  window.IFrameWorker = IFrameWorker;
  window.Worker = IFrameWorker;
}
