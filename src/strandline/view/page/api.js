// Requests to the server of this page.

async function told(answer) {
  const found = await answer.json().catch(() => ({ error: `the server answered ${answer.status}` }));
  if (!answer.ok) throw new Error(found.error || `the server answered ${answer.status}`);
  return found;
}

export async function get(name, query = {}) {
  const text = new URLSearchParams(query).toString();
  return told(await fetch(`api/${name}${text ? `?${text}` : ""}`));
}

export async function post(name, body) {
  const headers = { "Content-Type": "application/json" };
  return told(await fetch(`api/${name}`, { method: "POST", headers, body: JSON.stringify(body) }));
}

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
