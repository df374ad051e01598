/** Numbers as text: an unknown one is a dash, never a zero. */

export const UNKNOWN = "–";

export function length(metres) {
  if (metres === null || metres === undefined) return UNKNOWN;
  if (metres < 0.0995) return `${(1000 * metres).toFixed(metres < 0.00995 ? 1 : 0)} mm`;
  return metres < 9.995 ? `${metres.toFixed(2)} m` : `${metres.toFixed(1)} m`;
}

export function number(value, digits, unit = "") {
  if (value === null || value === undefined) return UNKNOWN;
  return `${signed(value, digits)}${unit ? ` ${unit}` : ""}`;
}

/** With a true minus sign, and no minus before a zero. */
function signed(value, digits) {
  const text = Math.abs(value).toFixed(digits);
  return value < 0 && Number(text) !== 0 ? `−${text}` : text;
}

export function age(seconds) {
  if (seconds === null || seconds === undefined) return UNKNOWN;
  if (seconds < 1) return `${Math.round(1000 * seconds)} ms`;
  return seconds < 100 ? `${seconds.toFixed(1)} s` : span(seconds);
}

export function share(value) {
  if (value === null || value === undefined) return UNKNOWN;
  const percent = 100 * value;
  return `${percent > 0 && percent < 9.95 ? percent.toFixed(1) : percent.toFixed(0)} %`;
}

/** 1:02:03 or 2:03 */
export function span(seconds) {
  if (seconds === null || seconds === undefined) return UNKNOWN;
  if (seconds < 0) return `−${span(-seconds)}`;
  const whole = Math.floor(seconds);
  const parts = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60];
  const [hours, minutes, rest] = parts;
  const tail = `${String(rest).padStart(2, "0")}`;
  return hours ? `${hours}:${String(minutes).padStart(2, "0")}:${tail}` : `${minutes}:${tail}`;
}

export function clock(seconds) {
  const time = new Date(1000 * seconds);
  return [time.getHours(), time.getMinutes(), time.getSeconds()]
    .map((part) => String(part).padStart(2, "0"))
    .join(":");
}

export function bytes(count) {
  if (count === null || count === undefined) return UNKNOWN;
  if (count < 1e6) return `${(count / 1e3).toFixed(0)} kB`;
  return count < 1e9 ? `${(count / 1e6).toFixed(1)} MB` : `${(count / 1e9).toFixed(2)} GB`;
}
