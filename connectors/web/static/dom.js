// Elements of the page.

export const $ = (id) => document.getElementById(id);
export const number = new Intl.NumberFormat("en");
export const title = (finger) => (finger === "every" ? "The fingertip" : `Fingertip ${finger}`);
export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
export const sleep = (time) => new Promise((resolve) => setTimeout(resolve, time));

// Write text, without a change of the document if it is the same.
export function write(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

export function element(tag, kind = "", text = "") {
  const made = document.createElement(tag);
  if (kind) made.className = kind;
  if (text) made.textContent = text;
  return made;
}

// Return a row of a table.
export function line(...cells) {
  const tr = element("tr");
  tr.append(...cells);
  return tr;
}
