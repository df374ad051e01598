/** Settings in the browser's storage, or, if that is forbidden, in memory. */

const here = new Map();

/** `where` is "localStorage" (this browser) or "sessionStorage" (this tab). */
export function restore(where, key) {
  try {
    return window[where].getItem(key);
  } catch {
    return here.get(key) ?? null;
  }
}

export function store(where, key, value) {
  try {
    if (value === null) window[where].removeItem(key);
    else window[where].setItem(key, value);
  } catch {
    here.set(key, value);
  }
}
