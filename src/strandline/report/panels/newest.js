// Call `task` for the newest of many requests only: one is under way, and at most one waits.

export function newest(task) {
  let busy = false;
  let waiting = null;
  return async function ask(given) {
    if (busy) {
      waiting = { given };
      return;
    }
    busy = true;
    try {
      await task(given);
    } finally {
      busy = false;
      if (waiting) {
        const next = waiting;
        waiting = null;
        ask(next.given);
      }
    }
  };
}
