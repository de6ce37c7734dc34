// Starts a page: reads its data, and shows a message if that fails.

import { readPayload } from "sarmitsuba/unpack.js";

function fail(error) {
  const node = document.createElement("p");
  node.id = "failure";
  node.textContent = `This page could not start: ${error.message}. A browser of 2023 or later with WebGL2 is needed.`;
  document.body.append(node);
}

/**
 * @param {function} make creates the page from its data; the result has an async `start`
 * @param {object} more additional entries of `window.sarmitsuba`, for tests
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
