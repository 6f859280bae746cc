// What the page asks of the server. All addresses are relative: the secret is part of the page's own address.

// Gets a route, or posts a value to it; an error of the server has its status.
export async function ask(route, value) {
  const posted = { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(value) };
  const answer = await fetch(route, value === undefined ? {} : posted).catch(() => {
    throw new Error("The server does not answer: has the command ended? Nothing can be saved from this page.");
  });
  const sent = await answer.json();
  if (answer.ok) return sent;
  throw Object.assign(new Error(sent.error ?? `the server says ${answer.status}`), { status: answer.status });
}

export async function image(number) {
  const picture = new Image();
  picture.src = `image/${number}`;
  await picture.decode();
  return picture;
}
