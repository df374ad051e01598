/** Light or dark, before anything is painted: as the system has it, or as was chosen here. No module, so that it runs at once. */

(() => {
  try {
    const chosen = localStorage.getItem("formation-theme");
    if (chosen === "light" || chosen === "dark") document.documentElement.dataset.theme = chosen;
  } catch {
    // a browser that may remember nothing shows what the system has
  }
})();
