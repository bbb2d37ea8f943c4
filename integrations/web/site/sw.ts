/** Keeps the files of the site, each by the hash of its content, so that the page works without a network. */

/// <reference lib="webworker" />

declare const self: ServiceWorkerGlobalScope & {
  /** File -> hash; `ha2g web` writes it before this script. */
  FILES: Record<string, string>;
};

const { scope } = self.registration;
const CACHE = `ha2g-web ${scope}`;
const INDEX = "index.html";

/** Returns the URL under which a file with this content is kept. */
function keyOf(file: string): string {
  return new URL(`${file}?${encodeURIComponent(self.FILES[file])}`, scope).href;
}

/** Fetches the files whose content is not kept already; all of them or, with an error, no new version. */
async function keepAll(): Promise<void> {
  const cache = await caches.open(CACHE);
  await Promise.all(
    Object.keys(self.FILES).map(async (file) => {
      const key = keyOf(file);
      if (await cache.match(key)) return;
      const response = await fetch(new URL(file, scope), { cache: "no-cache", integrity: self.FILES[file] });
      if (!response.ok) throw new Error(`${file}: ${response.status}`);
      await cache.put(key, response);
    }),
  );
}

/** Removes what belongs to other versions. */
async function removeOld(): Promise<void> {
  const cache = await caches.open(CACHE);
  const wanted = new Set(Object.keys(self.FILES).map(keyOf));
  for (const request of await cache.keys()) if (!wanted.has(request.url)) await cache.delete(request);
}

async function answer(request: Request, file: string): Promise<Response> {
  const cache = await caches.open(CACHE);
  return (await cache.match(keyOf(file))) ?? fetch(request);
}

self.addEventListener("install", (event) => event.waitUntil(keepAll()));
self.addEventListener("activate", (event) => event.waitUntil(removeOld()));
self.addEventListener("message", ({ data }) => {
  if (data === "activate") void self.skipWaiting();
});
self.addEventListener("fetch", (event) => {
  const { method, url } = event.request;
  const address = new URL(url);
  if (method !== "GET" || !url.startsWith(scope)) return;
  const file = address.pathname.slice(new URL(scope).pathname.length) || INDEX;
  if (Object.hasOwn(self.FILES, file)) event.respondWith(answer(event.request, file));
});
