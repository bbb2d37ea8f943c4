/** Starts the page. */

import { workOffline } from "./offline.js";
import { Page } from "./page.js";

declare global {
  interface Window {
    /** The page, for scripts that check it. */
    site: Page;
  }
}

const page = (window.site = new Page());
await page.started; // the model comes first
workOffline(() => page.say("A new version of this page is ready; load the page again to use it.")).catch((error: Error) => {
  console.warn(`The page will not work without a network: ${error.message}`);
});
