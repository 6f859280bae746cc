// What the page asks of the server. All addresses are relative: the secret is part of the page's own address.

export class ServerError extends Error {
  constructor(message, status) {
    super(message);
    this.status = status;
  }
}

async function ask(route, options = {}) {
  let answer;
  try {
    answer = await fetch(route, options);
  } catch {
    throw new ServerError("The server does not answer: has the command ended? Nothing can be saved from this page.", 0);
  }
  const sent = await answer.json();
  if (!answer.ok) throw new ServerError(sent.error ?? `the server says ${answer.status}`, answer.status);
  return sent;
}

const post = (route, value) =>
  ask(route, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(value) });

export const state = () => ask("state");
export const fit = (points) => post("fit", { points });
export const save = (points, revision) => post("save", { points, revision });
export const done = () => post("done", {});

export async function image(number) {
  const picture = new Image();
  picture.src = `image/${number}`;
  await picture.decode();
  return picture;
}
