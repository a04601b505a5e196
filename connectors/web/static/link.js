// Link between the panes of a comparison: they share the selected time, zoom and window, and labels of the same session.

const query = new URLSearchParams(location.search);
export const PANE = Number(query.get("pane") ?? 0);
export const BASE = PANE ? `${PANE}/` : ""; // of the requests of this pane
export const ALONE = !query.has("pane");

export class Link {
  // `on` has `moved(state, offset)` and `labelled(labels)`; `state()` returns what the panes share, with time `t` (ms).
  constructor(state, on) {
    Object.assign(this, { state, on, linked: true, offset: 0, other: null, sent: "" });
    this.channel = query.has("link") ? new BroadcastChannel(query.get("link")) : null;
    this.channel?.addEventListener("message", ({ data }) => this.#take(data));
  }

  // Send the state if it changed.
  send() {
    if (!this.channel) return;
    const state = this.state(), text = JSON.stringify(state);
    if (text === this.sent) return;
    this.sent = text;
    this.channel.postMessage({ pane: PANE, state });
  }

  sendLabels(labels) {
    this.channel?.postMessage({ pane: PANE, labels });
  }

  #take({ pane, state, labels, linked }) {
    if (linked !== undefined) {
      this.linked = linked;
      if (linked && this.other) this.offset = this.state().t - this.other.t; // keep the times that were set apart
    }
    if (pane === undefined || pane === PANE) return;
    if (labels) this.on.labelled(labels);
    if (!state) return;
    this.other = state;
    if (!this.linked) return;
    this.on.moved(state, this.offset);
    this.sent = JSON.stringify(this.state()); // as received: do not send it back
  }
}
