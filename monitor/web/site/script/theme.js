/** Set the chosen theme before anything is painted. No module, so that it runs at once. */

(() => {
  try {
    const chosen = localStorage.getItem("formation-theme");
    if (chosen === "light" || chosen === "dark") document.documentElement.dataset.theme = chosen;
  } catch {
    // without storage the system's theme is used
  }
})();
