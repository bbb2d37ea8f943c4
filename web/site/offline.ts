/** The service worker, with which the page works without a network once it was loaded. */

import { fileOf } from "./elements.js";

/**
 * Starts the service worker.
 *
 * A new version of the site is fetched while the old one is used. The next start of the page takes it.
 *
 * @param onnew - is called when a new version is there.
 */
export async function workOffline(onnew: () => void): Promise<void> {
  if (!("serviceWorker" in navigator)) return; // a page of http:// on another computer, or a private window
  const { serviceWorker } = navigator;
  const before = await serviceWorker.getRegistration(fileOf("./"));
  if (before?.waiting && before.active) {
    const changed = new Promise((resolve) => serviceWorker.addEventListener("controllerchange", resolve, { once: true }));
    before.waiting.postMessage("activate");
    await changed;
    location.reload();
    return;
  }
  const registration = await serviceWorker.register(fileOf("sw.js"), { updateViaCache: "none" });
  registration.addEventListener("updatefound", () => {
    const found = registration.installing;
    found?.addEventListener("statechange", () => {
      if (found.state === "installed" && registration.active) onnew();
    });
  });
}
