// The stream of events from the server: open while the page is seen, closed while it is hidden, opened anew when the asked fields change.

export class Stream {
  /** `handlers`: run, waiting, view, latency take the event's data; link(kind, sentence) the state of the connection. */
  constructor(handlers) {
    this.handlers = handlers;
    this.fields = [];
    this.source = null;
    document.addEventListener("visibilitychange", () => (document.hidden ? this.close() : this.open()));
  }

  ask(fields) {
    this.fields = fields;
    this.open();
  }

  open() {
    this.close();
    if (document.hidden) return;
    const source = new EventSource(`/stream?fields=${encodeURIComponent(this.fields.join(";"))}`);
    this.source = source;
    for (const name of ["run", "waiting", "view", "latency"]) {
      source.addEventListener(name, (event) => this.handlers[name](JSON.parse(event.data)));
    }
    source.addEventListener("error", () => {
      this.handlers.link("lost", "mip-rt monitor does not answer; trying again");
      // The browser tries again by itself unless it was refused for good.
      if (source.readyState === EventSource.CLOSED && this.source === source) setTimeout(() => this.source === source && this.open(), 2000);
    });
  }

  close() {
    this.source?.close();
    this.source = null;
  }
}
