// The page: puts the panes, the list and the server together.

import { Pairs } from "./pairs.js";
import { Pane } from "./pane.js";
import { NEEDED, fillList, plural, sentence } from "./list.js";
import { ask, image } from "./server.js";

const byId = (id) => document.getElementById(id);

let pairs, panes = [], revision, fileName, judgedFrom;
let found = null; // the fit: F, and by id its residuals and which pairs are far off
let fitted = null, fitting = false; // the list that was fitted last; whether an answer is awaited
let selected = null, hovered = null, activeSide = 0, showLines = true, drawing = false, ended = false;

// --- what is shown

function redraw() {
  if (drawing || panes.length < 2) return;
  drawing = true;
  requestAnimationFrame(() => {
    drawing = false;
    const { list, pending, pendingColour } = pairs;
    const colour = (id) => pairs.colour(id), strong = (id) => id === selected || id === hovered;
    const scene = { pairs: list, pending, pendingColour, farOff: found?.farOff ?? new Set(), colour, strong, lines };
    for (const pane of panes) pane.draw(scene);
  });
}

// The epipolar lines in one image: of the point that waits for its partner, else of the pair under the cursor.
function lines(side) {
  if (!found?.F || !showLines) return [];
  const { pending } = pairs;
  if (pending) return pending.side === side ? [] : [{ line: lineOf(pending.xy, side), colour: pairs.pendingColour }];
  const pair = pairs.find(hovered) ?? pairs.find(selected);
  return pair ? [{ line: lineOf(pair.points[1 - side], side), colour: pairs.colour(pair.id) }] : [];
}

// x2' F x1 = 0: a point of image 1 gives the line F x1 in image 2, a point of image 2 the line F' x2 in image 1.
function lineOf([x, y], side) {
  const { F } = found;
  const at = (row, column) => (side === 1 ? F[row][column] : F[column][row]);
  return [0, 1, 2].map((row) => at(row, 0) * x + at(row, 1) * y + at(row, 2));
}

function refresh() {
  const { pending, dirty } = pairs;
  const count = pairs.list.length;
  byId("count").textContent = count;
  byId("undo").disabled = !pairs.canUndo;
  byId("redo").disabled = !pairs.canRedo;
  byId("save").disabled = !dirty;
  byId("saved").textContent = dirty ? "not saved" : revision ? "saved" : "new";
  byId("saved").classList.toggle("dirty", dirty);
  const first = "Click a point in either image, then the same point in the other.";
  const next = `Now the same point in the ${pending?.side === 0 ? "second" : "first"} image.`;
  byId("hint").textContent = pending ? next : count ? "" : first;
  byId("hint").classList.toggle("next", Boolean(pending));
  for (const pane of panes) pane.root.classList.toggle("wanted", Boolean(pending) && pending.side !== pane.side);
  document.title = `${dirty ? "• " : ""}${fileName} · epiprior label`;
  const [text, bad] = sentence(count, found, judgedFrom);
  byId("fitted").textContent = text;
  byId("fitted").classList.toggle("bad", bad);
  fillList(byId("list"), pairs, found, { selected, hovered });
  redraw();
}

function say(text, actions = []) {
  const box = byId("message");
  box.hidden = !text;
  box.querySelector("span").textContent = text ?? "";
  box.querySelector("div").replaceChildren(...[...actions, ["Close", () => {}]].map(([label, act]) => {
    const button = document.createElement("button");
    button.textContent = label;
    button.addEventListener("click", () => { say(null); act(); });
    return button;
  }));
}

// --- changes

function changed() {
  if (!pairs.find(selected)) selected = null;
  if (!pairs.find(hovered)) hovered = null;
  if (pairs.list.length < NEEDED) found = null;
  refresh();
  return fitAgain();
}

// One question at a time: what changes meanwhile, as during a drag, is asked about once the answer is there.
async function fitAgain() {
  if (fitting) return;
  fitting = true;
  while (pairs.list.length >= NEEDED && fitted !== pairs.list) {
    const list = pairs.list;
    try {
      found = arranged(list, await ask("fit", { points: list.map(({ points }) => points.flat()) }));
    } catch (error) {
      found = null;
      if (!ended) say(error.message);
    }
    fitted = list;
    if (pairs.list.length < NEEDED) found = null;
    refresh();
  }
  fitting = false;
}

function arranged(list, { F, residuals = [], far_off = [], one_plane: onePlane = false }) {
  const ids = list.map(({ id }) => id);
  const farOff = new Set(ids.filter((_, index) => far_off[index]));
  return { F, onePlane, farOff, residuals: new Map(F ? ids.map((id, index) => [id, residuals[index]]) : []) };
}

const select = (id) => { selected = id; refresh(); };
const remove = (id) => { if (id !== null) { pairs.remove(id); changed(); } };

const events = {
  changed: redraw,
  hover(side, id) {
    activeSide = side;
    const now = typeof id === "number" ? id : null;
    if (now === hovered) return redraw();
    hovered = now;
    return refresh();
  },
  select: (id) => select(id === "pending" ? null : id),
  place(side, xy) { selected = pairs.place(side, xy); changed(); },
  drag(side, id, [dx, dy], going) {
    const [x, y] = id === "pending" ? pairs.pending.xy : pairs.find(id).points[side];
    const xy = panes[side].clamp([x + dx, y + dy]);
    if (id === "pending") pairs.movePending(xy, going);
    else { pairs.move(id, side, xy, going); selected = id; }
    changed();
  },
};

// --- the server

// Returns a function whose error is shown.
const attempt = (act) => () => act().catch((error) => say(error.message));

async function save() {
  const points = pairs.points();
  try {
    ({ revision } = await ask("save", { points, revision }));
  } catch (error) {
    const offers = [["Save mine all the same", overwrite], ["Load that file instead", load]];
    if (error.status === 409) say(`${error.message}.`, offers);
    else say(`Not saved: ${error.message}`);
    return false;
  }
  say(null);
  pairs.markSaved(points);
  refresh();
  return true;
}

const overwrite = attempt(async () => {
  ({ revision } = await ask("state"));
  await save();
});

const load = attempt(async () => {
  const state = await ask("state");
  revision = state.revision;
  pairs.replace(state.points);
  changed();
});

const done = attempt(async () => {
  if (pairs.dirty && !(await save())) return;
  const { count } = await ask("done", {});
  ended = true;
  byId("end").hidden = false;
  const what = count === null ? "Nothing was saved." : `${plural(count, "pair")} of points in ${fileName}.`;
  byId("end").firstElementChild.textContent = `${what} You can close this tab.`;
});

// --- keys and buttons

const toggle = (button, shown) => byId(button).setAttribute("aria-pressed", String(shown));
const fitAll = () => panes.forEach((pane) => pane.fit());
const back = (step) => () => { pairs[step](); changed(); };
const zoom = (factor) => () => panes[activeSide].zoomTo(panes[activeSide].scale * factor);
const removeSelected = () => remove(selected);

function toggleLines() {
  showLines = !showLines;
  toggle("lines", showLines);
  redraw();
}

function toggleKeys() {
  byId("keys").hidden = !byId("keys").hidden;
  toggle("help", !byId("keys").hidden);
}

const nudge = (dx, dy) => (event) => {
  const pair = pairs.find(selected);
  if (!pair) return;
  const pane = panes[activeSide];
  const step = (event.shiftKey ? 10 : 1) / pane.scale;
  const [x, y] = pair.points[activeSide];
  pairs.move(selected, activeSide, pane.clamp([x + dx * step, y + dy * step]));
  changed();
};

function escape() {
  if (!byId("keys").hidden) return toggleKeys();
  if (!pairs.pending) return select(null);
  pairs.dropPending();
  return changed();
}

const keys = {
  ArrowLeft: nudge(-1, 0), ArrowRight: nudge(1, 0), ArrowUp: nudge(0, -1), ArrowDown: nudge(0, 1),
  Delete: removeSelected, Backspace: removeSelected, Escape: escape,
  "+": zoom(1.25), "=": zoom(1.25), "-": zoom(0.8), 1: () => panes[activeSide].zoomTo(1 / devicePixelRatio),
  f: fitAll, l: toggleLines, "?": toggleKeys,
};
const controlKeys = { z: back("undo"), y: back("redo"), Z: back("redo"), s: save };
const buttons = { undo: back("undo"), redo: back("redo"), fit: fitAll, lines: toggleLines, help: toggleKeys, save, done };

function listen() {
  for (const [id, act] of Object.entries(buttons)) byId(id).addEventListener("click", () => act());
  addEventListener("keydown", (event) => {
    const control = event.ctrlKey || event.metaKey;
    const shifted = control && event.shiftKey;
    const key = event.key.length > 1 ? event.key : shifted ? event.key.toUpperCase() : event.key.toLowerCase();
    const act = control ? controlKeys[key] : event.altKey ? undefined : keys[key];
    if (!act || ended) return;
    event.preventDefault();
    act(event);
  });
  addEventListener("beforeunload", (event) => { if (pairs.dirty && !ended) event.preventDefault(); });
  const list = byId("list");
  const idOf = (event) => (event.target.closest("li") ? Number(event.target.closest("li").dataset.id) : null);
  list.addEventListener("click", (event) => {
    const id = idOf(event);
    if (id === null) return;
    if (event.target.closest("button")) return remove(id);
    for (const pane of panes) pane.show(pairs.find(id).points[pane.side]);
    select(id);
  });
  const hoverRow = (id) => {
    if (id === hovered) return;
    hovered = id;
    for (const row of list.children) row.classList.toggle("hovered", Number(row.dataset.id) === id);
    redraw();
  };
  list.addEventListener("mouseover", (event) => hoverRow(idOf(event)));
  list.addEventListener("mouseleave", () => hoverRow(null));
}

attempt(async () => {
  const [state, ...pictures] = await Promise.all([ask("state"), image(1), image(2)]);
  ({ revision, file: fileName, judged_from: judgedFrom } = state);
  pairs = new Pairs(state.points);
  byId("file").textContent = fileName;
  for (const side of [0, 1]) panes.push(new Pane(byId(`pane${side + 1}`), side, pictures[side], state.images[side], events));
  listen();
  await changed();
  document.body.dataset.ready = "yes";
})();
