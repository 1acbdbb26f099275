// Requests to the server of this page.

async function parsed(answer) {
  const found = await answer.json().catch(() => ({ error: `the server answered ${answer.status}` }));
  if (!answer.ok) throw new Error(found.error || `the server answered ${answer.status}`);
  return found;
}

export async function get(name, query = {}) {
  const text = new URLSearchParams(query).toString();
  return parsed(await fetch(`api/${name}${text ? `?${text}` : ""}`));
}

export async function post(name, body) {
  const headers = { "Content-Type": "application/json" };
  return parsed(await fetch(`api/${name}`, { method: "POST", headers, body: JSON.stringify(body) }));
}
