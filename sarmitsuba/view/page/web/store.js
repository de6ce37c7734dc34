// State of the page, with listeners for changes.

export class Store {
  constructor(values) {
    this.values = { ...values };
    this.listeners = [];
  }

  get(name) {
    return this.values[name];
  }

  /** Change values; listeners of any that changed are called once. */
  set(changes) {
    const changed = Object.keys(changes).filter((name) => this.values[name] !== changes[name]);
    Object.assign(this.values, changes);
    if (changed.length === 0) return;
    for (const { names, call } of this.listeners) {
      if (names.some((name) => changed.includes(name))) call(this.values, changed);
    }
  }

  on(names, call) {
    this.listeners.push({ names, call });
  }
}
