// Starts a page: reads its numbers, and says so when it cannot be shown.

import { readPayload } from "sarmitsuba/unpack.js";

function fail(error) {
  const node = document.createElement("p");
  node.id = "failure";
  node.textContent = `This page could not start: ${error.message}. A browser of 2023 or later with WebGL2 is needed.`;
  document.body.append(node);
}

/**
 * @param {function} make of the page's numbers; what it returns has an async `start`
 * @param {object} more what tests, and the curious, find beside the page in `window.sarmitsuba`
 */
export async function boot(make, more = {}) {
  try {
    performance.mark("modules");
    const page = make(await readPayload());
    performance.mark("numbers");
    window.sarmitsuba = { page, ...more };
    await page.start();
    performance.mark("ready");
    document.documentElement.dataset.ready = "true";
  } catch (error) {
    fail(error);
    throw error;
  }
}
