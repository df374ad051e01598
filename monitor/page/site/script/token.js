/** The word that allows to give orders. It comes in the address after #, which browsers send to nobody. */

import { recall, remember } from "./store.js";

const KEY = "formation-token";

/** Take the token out of the address bar, so that nobody reads or bookmarks it; it stays with this tab. */
export function takeFromAddress() {
  const found = new URLSearchParams(location.hash.slice(1)).get("token");
  if (found === null) return;
  keep(found);
  history.replaceState(null, "", location.pathname + location.search);
}

export function token() {
  return recall("sessionStorage", KEY) ?? "";
}

export function keep(word) {
  remember("sessionStorage", KEY, word.trim());
}

export function forget() {
  remember("sessionStorage", KEY, null);
}
