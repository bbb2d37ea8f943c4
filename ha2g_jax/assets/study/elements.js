// Elements of a page, made without any HTML text.

export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false && value !== null) made.setAttribute(name, value);
  }
  made.append(...children);
  return made;
}

// Shows the parts of a page and moves the focus to its heading, so that a screen reader begins there.
export function show(display, heading, ...parts) {
  const title = element("h1", { tabindex: -1 }, heading);
  display.replaceChildren(title, ...parts);
  scrollTo(0, 0);
  title.focus({ preventScroll: true });
}
