// The pairs of points, with undo and redo. A state is never changed, only followed by another.

const COLOURS = ["#f0e442", "#56b4e9", "#ff8c3c", "#3cc896", "#f082c8", "#ffffff", "#8fa2ff", "#bef078", "#c9a27a", "#4ee1e6"];
const STEPS = 1e4; // a click is kept to a ten-thousandth of a pixel

const rounded = (xy) => xy.map((value) => Math.round(value * STEPS) / STEPS + 0);

export class Pairs {
  // A pair: {id, points: [[x1, y1], [x2, y2]]}; pending: {side, xy}, a point without a partner.
  constructor(points) { this.next = 0; this.replace(points); }

  replace(points) {
    const pairs = points.map(([x1, y1, x2, y2]) => ({ id: this.next++, points: [[x1, y1], [x2, y2]] }));
    Object.assign(this, { past: [], future: [], now: { pairs, pending: null } });
    this.markSaved();
  }

  get list() { return this.now.pairs; }
  get pending() { return this.now.pending; }
  get canUndo() { return this.past.length > 0; }
  get canRedo() { return this.future.length > 0; }
  get dirty() { return this.saved !== JSON.stringify(this.points()); }

  points() { return this.now.pairs.map(({ points }) => points.flat()); }
  markSaved(points = this.points()) { this.saved = JSON.stringify(points); }
  find(id) { return this.now.pairs.find((pair) => pair.id === id); }
  colour(id) { return COLOURS[id % COLOURS.length]; }
  // The colour that the point without a partner will have.
  get pendingColour() { return this.colour(this.next); }

  // Returns the id of the pair that the point completes, or null.
  place(side, xy) {
    const { pairs, pending } = this.now;
    if (!pending || pending.side === side) {
      this.#follow({ pairs, pending: { side, xy: rounded(xy) } });
      return null;
    }
    const points = side === 1 ? [pending.xy, rounded(xy)] : [rounded(xy), pending.xy];
    const id = this.next++;
    this.#follow({ pairs: [...pairs, { id, points }], pending: null });
    return id;
  }

  // With `going`, the move goes on: it is one step for undo.
  move(id, side, xy, going = false) {
    const pairs = this.now.pairs.map((pair) =>
      pair.id === id ? { id, points: pair.points.map((point, k) => (k === side ? rounded(xy) : point)) } : pair);
    this.#follow({ ...this.now, pairs }, going);
  }

  movePending(xy, going = false) {
    this.#follow({ ...this.now, pending: { side: this.pending.side, xy: rounded(xy) } }, going);
  }

  remove(id) {
    if (this.find(id)) this.#follow({ ...this.now, pairs: this.now.pairs.filter((pair) => pair.id !== id) });
  }

  dropPending() { if (this.pending) this.#follow({ ...this.now, pending: null }); }
  undo() { this.#step(this.past, this.future); }
  redo() { this.#step(this.future, this.past); }

  #step(from, to) {
    if (!from.length) return;
    to.push(this.now);
    this.now = from.pop();
  }

  #follow(state, going = false) {
    if (!going) this.past.push(this.now);
    this.future = [];
    this.now = state;
  }
}
