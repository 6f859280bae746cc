// The list of pairs beside the images, and what their fit says, in a sentence.

export const NEEDED = 8; // pairs that decide F

export const plural = (count, noun) => `${count} ${noun}${count === 1 ? "" : "s"}`;

// Returns the sentence, and whether it is a warning.
export function sentence(count, found, judgedFrom) {
  if (count < NEEDED) return [`${NEEDED - count} more until F can be fitted.`, false];
  if (!found) return ["…", false];
  if (!found.F) return ["These points decide no F: spread them over the images.", true];
  const sorted = [...found.residuals.values()].sort((p, q) => p - q);
  const numbers = `median ${sorted[sorted.length >> 1].toFixed(2)} px, largest ${sorted.at(-1).toFixed(2)} px`;
  if (found.farOff.size) return [`${plural(found.farOff.size, "pair")} far off: ${numbers}`, true];
  if (found.onePlane) return [`One plane explains all points: add some at other depths. Now ${numbers}`, true];
  if (count < judgedFrom) return [`Residuals: ${numbers}. Mistakes can be told from ${judgedFrom} pairs on.`, false];
  return [`Residuals: ${numbers}`, false];
}

export function fillList(list, pairs, found, { selected, hovered }) {
  const largest = Math.max(2, ...(found?.residuals.values() ?? []));
  list.replaceChildren(...pairs.list.map((pair, index) => {
    const residual = found?.residuals.get(pair.id);
    const row = document.createElement("li");
    row.dataset.id = pair.id;
    const states = { selected: pair.id === selected, hovered: pair.id === hovered, far: found?.farOff.has(pair.id) };
    for (const [name, set] of Object.entries(states)) row.classList.toggle(name, set ?? false);
    row.style.setProperty("--colour", pairs.colour(pair.id));
    addCell(row, "span", "number", index + 1);
    const [first, second] = pair.points.map(([x, y]) => `${x.toFixed(1)}, ${y.toFixed(1)}`);
    addCell(row, "span", "points").append(first, document.createElement("br"), second);
    const distance = addCell(row, "span", "residual", residual === undefined ? "" : `${residual.toFixed(2)} px`);
    if (residual !== undefined) {
      const bar = document.createElement("i");
      bar.style.setProperty("--part", `${Math.min(100, (100 * residual) / largest)}%`);
      distance.append(bar);
    }
    addCell(row, "button", "remove", "×").title = "Delete this pair (Del)";
    return row;
  }));
}

function addCell(row, kind, name, text = "") {
  const cell = Object.assign(document.createElement(kind), { className: name, textContent: text });
  row.append(cell);
  return cell;
}
