/** The service worker, with which the page works without a network once it was loaded. */

import { fileOf } from "./elements.js";

/**
 * Takes a version of the site that was fetched while the page was open before: the page is loaded again.
 *
 * @param isUsed - whether the visitor has begun, so that the page stays as it is, also when another page takes it.
 */
export async function takeNewVersion(isUsed: () => boolean): Promise<void> {
  const container = navigator.serviceWorker as ServiceWorkerContainer | undefined;
  if (!container?.controller) return;
  container.addEventListener("controllerchange", () => {
    if (!isUsed()) location.reload();
  });
  const registration = await container.getRegistration(fileOf("./"));
  registration?.waiting?.postMessage("activate");
}

/**
 * Keeps the files of the site. A new version is fetched while the old one is used; the next start of the page takes it.
 *
 * @param onnew - is called when a new version is there.
 */
export async function workOffline(onnew: () => void): Promise<void> {
  const container = navigator.serviceWorker as ServiceWorkerContainer | undefined;
  if (!container) return; // a page of http:// on another computer, or a private window
  const registration = await container.register(fileOf("sw.js"), { updateViaCache: "none" });
  const { active } = registration;
  if (!active) return; // this is the first version
  const watch = (worker: ServiceWorker | null) => {
    if (worker?.state === "installed") onnew();
    else worker?.addEventListener("statechange", () => worker.state === "installed" && onnew());
  };
  watch(registration.waiting ?? registration.installing);
  registration.addEventListener("updatefound", () => watch(registration.installing));
}
