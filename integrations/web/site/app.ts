/** Starts the page. */

import { listen } from "./keys.js";
import { say } from "./news.js";
import { takeNewVersion, workOffline } from "./offline.js";
import { Page } from "./page.js";

declare global {
  interface Window {
    /** The page, for scripts that check it. */
    site: Page;
  }
}

const NEWER = "A new version of this page is ready; load the page again to use it.";

async function start(): Promise<void> {
  const page = (window.site = new Page());
  listen(page);
  await takeNewVersion(() => page.isBusy || page.take !== null);
  await page.started; // the model comes first
  await workOffline(() => say(NEWER));
}

start().catch((error: Error) => console.warn(`The page will not work without a network: ${error.message}`));
