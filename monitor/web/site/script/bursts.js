/** Events as lines. The same event of many robots at once is one line: a hundred that join would hide all others. */

const AT_ONCE = 1; // time within which events of one kind belong together [s]
const MANY = 3; // number of robots from which on they are one line
const NAMED = 2; // number of those robots that are named

/** Lists of events, each of them a line, newest first; `events` come oldest first. */
export function lines(events) {
  const begun = new Map();
  const groups = [];
  for (const event of events) {
    const what = `${event.level} ${event.kind}`;
    let group = begun.get(what);
    if (!event.robot || !group || !takes(group, event)) {
      group = [];
      groups.push(group);
      if (event.robot) begun.set(what, group);
    }
    group.push(event);
  }
  return groups
    .flatMap((group) => (group.length < MANY ? group.map((event) => [event]) : [group]))
    .sort((one, other) => newest(other).n - newest(one).n);
}

function takes(group, { at, robot }) {
  return Math.abs(at - group[0].at) <= AT_ONCE && !group.some((event) => event.robot === robot);
}

function newest(events) {
  return events[events.length - 1];
}

/** "robot2, robot3 and 98 more: in formation control", with the text if it is the same for all. */
export function sum(events) {
  const names = events.slice(0, NAMED).map((event) => event.robot).join(", ");
  const [{ text }] = events;
  const same = events.every((event) => event.text === text);
  return `${names} and ${events.length - NAMED} more${same ? `: ${text}` : ""}`;
}
