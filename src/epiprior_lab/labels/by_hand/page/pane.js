// One image on its canvas: zoom, pan, markers, epipolar lines, loupe.
//
// Three kinds of coordinates. Image: pixels, the centre of the top-left pixel at (0, 0), so its corner is at
// (-0.5, -0.5). Canvas: CSS pixels from the canvas's corner. The mouse stands on a pixel of the screen and its numbers
// are that pixel's corner; its centre is meant, half a pixel further.

const NEAR = 10; // of a marker, CSS pixels
const DRAG = 4; // further than that, a press is a drag
const LOUPE = 148;
const LARGEST_SCALE = 64;

export class Pane {
  constructor(root, side, picture, size, on) {
    Object.assign(this, { root, side, picture, on, width: size.width, height: size.height });
    this.canvas = root.querySelector("canvas");
    this.where = root.querySelector(".where");
    this.paper = this.canvas.getContext("2d");
    this.cursor = this.press = this.scene = null; // the cursor in canvas coordinates
    root.querySelector("h2 span").textContent = `${size.name}  ·  ${size.width} × ${size.height}`;
    new ResizeObserver(() => this.#resized()).observe(this.canvas);
    this.#resized();
    this.#listen();
  }

  // --- coordinates

  toImage([x, y]) { return [(x - this.left) / this.scale - 0.5, (y - this.top) / this.scale - 0.5]; }
  toCanvas([x, y]) { return [(x + 0.5) * this.scale + this.left, (y + 0.5) * this.scale + this.top]; }
  inside([x, y]) { return x >= -0.5 && y >= -0.5 && x <= this.width - 0.5 && y <= this.height - 0.5; }
  clamp([x, y]) {
    return [Math.min(Math.max(x, -0.5), this.width - 0.5), Math.min(Math.max(y, -0.5), this.height - 0.5)];
  }

  #fromMouse(event) {
    const box = this.canvas.getBoundingClientRect();
    const centre = (value) => (Math.floor(value * devicePixelRatio) + 0.5) / devicePixelRatio;
    return [centre(event.clientX) - box.left, centre(event.clientY) - box.top];
  }

  // --- what part of the image is seen

  get middle() { return [this.wide / 2, this.high / 2]; }
  get fitting() { return Math.min(this.wide / this.width, this.high / this.height) * 0.98; }

  fit() {
    this.scale = this.fitting;
    this.centreOn([(this.width - 1) / 2, (this.height - 1) / 2]);
  }

  centreOn([x, y]) {
    this.left = this.wide / 2 - (x + 0.5) * this.scale;
    this.top = this.high / 2 - (y + 0.5) * this.scale;
    this.#keepInSight();
  }

  zoomTo(scale, at = this.cursor ?? this.middle) {
    const kept = this.toImage(at);
    this.scale = Math.min(Math.max(scale, Math.min(this.fitting, 1) * 0.5), LARGEST_SCALE);
    this.left = at[0] - (kept[0] + 0.5) * this.scale;
    this.top = at[1] - (kept[1] + 0.5) * this.scale;
    this.#keepInSight();
  }

  show(xy) { this.scale = Math.max(this.scale, 2); this.centreOn(xy); }

  #keepInSight() {
    const kept = (start, seen, length) => Math.min(Math.max(start, seen / 2 - length), seen / 2);
    this.left = kept(this.left, this.wide, this.width * this.scale);
    this.top = kept(this.top, this.high, this.height * this.scale);
    this.on.changed();
  }

  #resized() {
    const wide = this.canvas.clientWidth, high = this.canvas.clientHeight;
    if (!wide || !high || (wide === this.wide && high === this.high && this.ratio === devicePixelRatio)) return;
    const middle = this.scale ? this.toImage(this.middle) : null;
    const fitted = !middle || Math.abs(this.scale / this.fitting - 1) < 1e-6;
    Object.assign(this, { wide, high, ratio: devicePixelRatio });
    this.canvas.width = Math.round(wide * devicePixelRatio);
    this.canvas.height = Math.round(high * devicePixelRatio);
    if (fitted) this.fit();
    else this.centreOn(middle);
    if (this.scene) this.draw(this.scene); // at once: a new size has emptied the canvas
  }

  // --- the mouse

  #listen() {
    const { canvas } = this;
    const on = (kind, act) => canvas.addEventListener(kind, act);
    on("pointerdown", (event) => this.#pressed(event));
    on("pointermove", (event) => this.#moved(event));
    on("pointerup", (event) => this.#released(event));
    on("pointercancel", () => { this.press = null; });
    on("contextmenu", (event) => event.preventDefault());
    on("pointerleave", () => { this.cursor = null; this.on.hover(this.side, null); });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 33 : 1;
      const speed = event.ctrlKey ? 0.01 : 0.0018; // a pinch comes as a wheel with Ctrl
      this.zoomTo(this.scale * Math.exp(-event.deltaY * lines * speed), this.#fromMouse(event));
    }, { passive: false });
  }

  // The id of the marker near a place, "pending", or null.
  hit(at) {
    if (!this.scene) return null;
    const { pairs, pending } = this.scene;
    if (pending && pending.side !== this.side) return null; // its partner may be anywhere
    let found = null, nearest = NEAR;
    const look = (id, xy) => {
      const [x, y] = this.toCanvas(xy);
      const distance = Math.hypot(x - at[0], y - at[1]);
      if (distance <= nearest) [found, nearest] = [id, distance];
    };
    for (const pair of pairs) look(pair.id, pair.points[this.side]);
    if (pending) look("pending", pending.xy);
    return found;
  }

  #pressed(event) {
    const at = this.#fromMouse(event);
    const id = event.button === 0 ? this.hit(at) : null;
    this.press = { button: event.button, start: at, last: at, id, dragged: false, pointer: event.pointerId };
    this.canvas.setPointerCapture(event.pointerId);
    document.activeElement?.blur?.();
    if (event.button !== 0) event.preventDefault();
  }

  #moved(event) {
    const at = this.#fromMouse(event);
    this.cursor = at;
    const { press } = this;
    if (!press) {
      const id = this.hit(at);
      this.canvas.classList.toggle("grab", id !== null);
      this.on.hover(this.side, id);
      return;
    }
    const going = press.dragged;
    press.dragged ||= Math.hypot(at[0] - press.start[0], at[1] - press.start[1]) > DRAG;
    if (!press.dragged) return;
    const [dx, dy] = [at[0] - press.last[0], at[1] - press.last[1]];
    press.last = at;
    if (press.id === null) {
      this.canvas.classList.add("pan");
      [this.left, this.top] = [this.left + dx, this.top + dy];
      this.#keepInSight();
    } else {
      this.on.drag(this.side, press.id, [dx / this.scale, dy / this.scale], going);
    }
  }

  #released(event) {
    const { press } = this;
    this.press = null;
    this.canvas.classList.remove("pan");
    if (!press || press.pointer !== event.pointerId || press.dragged || press.button !== 0) return;
    const xy = this.toImage(press.start);
    if (press.id !== null) this.on.select(press.id);
    else if (this.inside(xy)) this.on.place(this.side, xy);
  }

  // --- drawing

  draw(scene) {
    this.scene = scene;
    const { paper, ratio, scale } = this;
    paper.setTransform(ratio, 0, 0, ratio, 0, 0);
    paper.clearRect(0, 0, this.wide, this.high);
    paper.imageSmoothingEnabled = scale < 3; // closer, the pixels themselves are shown
    paper.imageSmoothingQuality = "high";
    paper.drawImage(this.picture, this.left, this.top, this.width * scale, this.height * scale);
    this.#drawLines();
    scene.pairs.forEach((pair, index) => {
      const look = { colour: scene.colour(pair.id), far: scene.farOff.has(pair.id), strong: scene.strong(pair.id) };
      this.#drawMarker(pair.points[this.side], String(index + 1), look);
    });
    const { pending } = scene;
    if (pending?.side === this.side) {
      this.#drawMarker(pending.xy, String(scene.pairs.length + 1), { colour: scene.pendingColour, open: true });
    }
    this.#drawLoupe();
    const xy = this.cursor && this.toImage(this.cursor);
    const place = xy && this.inside(xy) ? `x ${xy[0].toFixed(2)}   y ${xy[1].toFixed(2)}   ·   ` : "";
    this.where.textContent = `${place}${(scale * 100).toFixed(scale < 0.995 ? 1 : 0)} %`;
  }

  #stroke(colour, width, dash = []) {
    const { paper } = this;
    paper.setLineDash(dash);
    for (const [strokeStyle, lineWidth] of [["rgb(0 0 0 / .65)", width + 2], [colour, width]]) {
      Object.assign(paper, { strokeStyle, lineWidth }).stroke();
    }
    paper.setLineDash([]);
  }

  #cross(x, y, from, to) {
    for (const [u, v] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
      this.paper.moveTo(x + u * from, y + v * from);
      this.paper.lineTo(x + u * to, y + v * to);
    }
  }

  #rounded(x, y, wide, high, radius) {
    this.paper.beginPath();
    this.paper.roundRect(x, y, wide, high, radius);
  }

  #drawMarker(xy, number, { colour, far = false, strong = false, open = false }) {
    const { paper } = this;
    const [x, y] = this.toCanvas(xy);
    if (x < -40 || y < -40 || x > this.wide + 40 || y > this.high + 40) return;
    const radius = strong ? 10 : 8;
    paper.beginPath();
    paper.arc(x, y, radius, 0, 2 * Math.PI);
    this.#cross(x, y, radius - 4, radius + 4);
    this.#stroke(colour, strong ? 2.4 : 1.6, open ? [3, 3] : []);
    if (far) {
      paper.beginPath();
      paper.arc(x, y, radius + 7, 0, 2 * Math.PI);
      this.#stroke("#ff5a52", 2, [5, 4]);
    }
    paper.font = "600 11px system-ui, sans-serif";
    const text = far ? `${number} !` : number;
    const wide = paper.measureText(text).width + 8;
    const left = x + radius + 3 + wide < this.wide ? x + radius + 3 : x - radius - 3 - wide;
    const top = Math.max(y - radius - 11, 1);
    paper.fillStyle = far ? "#ff5a52" : colour;
    this.#rounded(left, top, wide, 15, 4);
    paper.fill();
    Object.assign(paper, { fillStyle: "#16181b", textBaseline: "middle" });
    paper.fillText(text, left + 4, top + 8);
  }

  // Lines a x + b y + c = 0, cut off at the rim of the image.
  #drawLines() {
    const { paper, width, height, scale } = this;
    paper.save();
    paper.beginPath();
    paper.rect(this.left, this.top, width * scale, height * scale);
    paper.clip();
    for (const { line: [a, b, c], colour } of this.scene.lines(this.side)) {
      const [x, y, reach] = [width / 2, height / 2, (width + height) / Math.hypot(a, b)];
      const off = (a * x + b * y + c) / (a * a + b * b); // of the middle of the image
      paper.beginPath();
      for (const part of [-reach, reach]) paper.lineTo(...this.toCanvas([x - off * a + part * b, y - off * b - part * a]));
      this.#stroke(colour, 1.4);
    }
    paper.restore();
  }

  // Around the cursor; while a partner is looked for in the other image, around the point that waits for it.
  #drawLoupe() {
    const { pending } = this.scene;
    const waiting = pending?.side === this.side && !this.cursor;
    const centre = waiting ? pending.xy : this.cursor && !this.press?.dragged ? this.toImage(this.cursor) : null;
    if (!centre || !this.inside(centre) || (!waiting && this.scale >= 8)) return;
    const { paper } = this;
    const scale = Math.min(Math.max(4 * this.scale, 4), 12);
    const [corner, reach] = [[this.wide - LOUPE - 10, this.high - LOUPE - 10], 50];
    const near = this.cursor && this.cursor[0] > corner[0] - reach && this.cursor[1] > corner[1] - reach;
    const [x, y] = near ? [corner[0], 46] : corner; // out of the cursor's way
    const [u, v] = [x + LOUPE / 2, y + LOUPE / 2];
    paper.save();
    this.#rounded(x, y, LOUPE, LOUPE, 10);
    paper.fillStyle = "#121316";
    paper.fill();
    paper.clip();
    paper.imageSmoothingEnabled = false;
    const [left, top] = [u - (centre[0] + 0.5) * scale, v - (centre[1] + 0.5) * scale];
    paper.drawImage(this.picture, left, top, this.width * scale, this.height * scale);
    paper.beginPath();
    this.#cross(u, v, 5, 22);
    this.#stroke(waiting ? this.scene.pendingColour : "#ffffff", 1);
    paper.restore();
    this.#rounded(x + 0.5, y + 0.5, LOUPE - 1, LOUPE - 1, 10);
    paper.strokeStyle = waiting ? this.scene.pendingColour : "#59606b";
    paper.lineWidth = 1.5;
    paper.stroke();
  }
}
