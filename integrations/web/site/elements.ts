/** Elements of the page. */

/** Returns the element of a selector, which the page has. */
export function find<T extends Element = HTMLElement>(selector: string): T {
  const found = document.querySelector<T>(selector);
  if (!found) throw new Error(`the page has no ${selector}`);
  return found;
}

/** Shows whether a button that can be on is on. */
export function press(button: Element, isOn: boolean): void {
  button.setAttribute("aria-pressed", String(isOn));
}

/** Shows or hides elements. */
export function show(isShown: boolean, ...selectors: string[]): void {
  for (const selector of selectors) find(selector).hidden = !isShown;
}

/** Returns the URL of a file of the site. */
export function fileOf(name: string): URL {
  return new URL(name, document.baseURI);
}

/** Offers a file for download. */
export function save(content: Blob, name: string): void {
  const url = URL.createObjectURL(content);
  Object.assign(document.createElement("a"), { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 60_000); // the browser reads it after the click
}
