// Overview of a whole session above the slider: pressure, slips and the span that the curves show.

const EDGE = 8; // px, half the thumb of the slider
const $ = (id) => document.getElementById(id);

export class Overview {
  constructor(view, length) {
    Object.assign(this, { view, length, canvas: $("overview"), whole: { touch: {} } });
  }

  // Load the session with `load(begin, end, at, columns)` and draw it whenever it changes.
  async load(load) {
    const draw = () => this.draw();
    this.whole = await load(0, this.length, 0, Math.max(1, this.canvas.clientWidth));
    new ResizeObserver(draw).observe(this.canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
    $("fingers").addEventListener("change", draw);
  }

  // Mark the span that the curves show.
  mark(begin, end) {
    const width = this.canvas.clientWidth, place = (t) => this.#x(width, Math.min(Math.max(t, 0), this.length));
    $("shown").style.left = `${place(begin)}px`;
    $("shown").style.width = `${Math.max(2, place(end) - place(begin))}px`;
  }

  draw() {
    const { canvas, view, whole, length } = this, style = getComputedStyle(document.documentElement);
    const width = canvas.clientWidth, height = canvas.clientHeight, x = (t) => this.#x(width, t);
    canvas.width = width * devicePixelRatio;
    canvas.height = height * devicePixelRatio;
    const pen = canvas.getContext("2d");
    pen.scale(devicePixelRatio, devicePixelRatio);
    pen.fillStyle = style.getPropertyValue("--middle");
    pen.globalAlpha = 0.55;
    const touch = whole.touch[view.finger ?? Object.keys(whole.touch)[0]];
    touch?.t.forEach((t, row) => {
      const value = Math.max(0, ...touch.v[row].map((each) => view.pressure(each, touch.zeroed)));
      const tall = Math.min(height - 8, ((height - 8) * value) / (touch.zeroed ? view.deepest : view.most));
      pen.fillRect(x(t), height - tall, 1, tall);
    });
    pen.globalAlpha = 1;
    pen.fillStyle = style.getPropertyValue("--slip");
    for (const [from, to] of view.events.spans(view.finger, length)) pen.fillRect(x(from), 0, Math.max(1.5, x(to) - x(from)), 5);
  }

  #x(width, t) {
    return EDGE + ((width - 2 * EDGE) * t) / this.length;
  }
}
