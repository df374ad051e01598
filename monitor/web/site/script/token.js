/** The token for orders. It is in the address after #, which browsers do not send. */

import { restore, store } from "./store.js";

const KEY = "formation-token";

/** Move the token from the address bar to this tab's storage, so that it is neither seen nor bookmarked. */
export function takeFromAddress() {
  const found = new URLSearchParams(location.hash.slice(1)).get("token");
  if (found === null) return;
  keep(found);
  history.replaceState(null, "", location.pathname + location.search);
}

export function token() {
  return restore("sessionStorage", KEY) ?? "";
}

export function keep(word) {
  store("sessionStorage", KEY, word.trim());
}

/** Random hexadecimal digits, two for each of `bytes`. */
export function randomId(bytes) {
  return [...crypto.getRandomValues(new Uint8Array(bytes))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Send `body` to the page's own server, with the token; give up after `patience` [ms]. */
export function post(path, body, patience) {
  return fetch(path, {
    method: "POST",
    headers: { "Content-Type": "application/json", Authorization: `Bearer ${token()}` },
    body: JSON.stringify(body),
    signal: AbortSignal.timeout(patience),
  });
}

export function forget() {
  store("sessionStorage", KEY, null);
}
