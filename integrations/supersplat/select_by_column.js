// Paste into the console of a browser that shows SuperSplat (F12), once a PLY of drsplat is open and chosen in its list.
// Then, for instance, selectByColumn("object_id", id => id === 9) or selectByColumn("relevancy", score => score > 0.5).
// Checked with SuperSplat 2.32.2. It uses what SuperSplat keeps in its page, which is no promise of its makers.
window.selectByColumn = (name, holds) => {
  const splat = window.scene.events.invoke("selection");
  const values = splat?.splatData.getProp(name);
  if (!values) throw new Error(`no column '${name}' in what is chosen: open a PLY that drsplat saved, and choose it`);
  const whole = values instanceof Uint32Array ? new Int32Array(values.buffer, values.byteOffset, values.length) : values;
  const mask = Uint8Array.from(whole, (value) => (holds(value) ? 255 : 0)); // 255 is selected; -1 comes as 2^32 - 1
  window.scene.events.fire("select.mask", "set", mask);
  return mask.reduce((count, value) => count + (value > 0), 0);
};
