// What the panels share. `tell(name)` calls those that listen to it.

const listeners = new Map();

export const shared = {
  facts: null, // what does not change
  state: {}, // how far the study has got
  runs: { row: [], number: [], state: [], kind: [], seconds: [], inputs: {} },
  posterior: null,
  asked: null, // the posterior under other assumptions
  run: null, // the run that is shown
  condition: 0, // place of the condition that is shown
  chosen: {}, // inputs of the sliders
  prediction: null, // the interface predicted there
};

export function listen(name, task) {
  listeners.set(name, [...(listeners.get(name) || []), task]);
}

export function tell(name) {
  for (const task of listeners.get(name) || []) task();
}
