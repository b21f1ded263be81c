// Panel: what can be chosen on the left, and the table of a point on the right.

const byId = id => document.getElementById(id);

function showFields(fields, groups, chosen) {
  byId("field").replaceChildren(...groups.map(group => createElement("optgroup", { label: group },
    ...fields.filter(field => field.group === group).map(field =>
      createElement("option", { value: field.name, selected: field.name === chosen, title: field.meaning }, field.label)))));
}

function showStatuses(names, counts, hidden, changed) {
  // Kinds without points are left out, except echoes; hidden kinds stay, to be shown again.
  const listed = names.map((name, i) => [name, i]).filter(([, i]) => i === 0 || counts[i] || hidden >> i & 1);
  byId("statuses").replaceChildren(byId("statuses").firstElementChild, ...listed.map(([name, i]) => createElement("label", {},
    createElement("input", { type: "checkbox", checked: !(hidden >> i & 1), onchange: event => changed(i, event.target.checked) }),
    `${name} (${(counts[i] ?? 0).toLocaleString("en")})`)));
}

// Sliders of a live scene. `settings` holds what was changed; `changed` is called with a key and its value.
function showControls(controls, settings, changed) {
  // What is of the run, such as frame and seed, comes first: it is what people look for.
  const ordered = [true, false].flatMap(ofRun => controls.filter(control => control.key.startsWith("run.") === ofRun));
  byId("controls").replaceChildren(...ordered.map(control => {
    const { key, label, unit, low, high, log, whole } = control;
    const value = settings[key] ?? control.value;
    const place = v => log ? Math.log(Math.max(v, low) / low) / Math.log(high / low) : (v - low) / (high - low);
    const slider = createElement("input", { type: "range", min: 0, max: 1, step: 0.001, value: place(value), ariaLabel: label });
    const box = createElement("input", { type: "number", step: "any", value: Number(value.toPrecision(4)), ariaLabel: label });
    const note = createElement("p", { id: `note-${key}`, hidden: true });
    slider.oninput = () => {
      const part = Number(slider.value);
      const moved = log ? low * (high / low) ** part : low + part * (high - low);
      box.value = whole ? Math.round(moved) : Number(moved.toPrecision(3));
      tell(box, note, "");
      changed(key, box.valueAsNumber);
    };
    box.onchange = () => {
      const wrong = mistake(box, control);
      tell(box, note, wrong);
      if (wrong) return;
      slider.value = place(box.valueAsNumber);
      changed(key, box.valueAsNumber);
    };
    return createElement("div", { className: "control" },
      createElement("div", {}, label, createElement("span", {}, box, " ", createElement("span", { className: "unit" }, unit))), slider, note);
  }));
}

// What is wrong with a number that was typed, or "".
function mistake(box, { least, most, whole, unit }) {
  const value = box.valueAsNumber, of = unit ? ` ${unit}` : "";
  if (!Number.isFinite(value)) return "must be a number";
  if (whole && !Number.isInteger(value)) return "must be a whole number";
  if (least !== null && value < least) return `must be >= ${least}${of}`;
  if (most !== null && value > most) return `must be <= ${most}${of}`;
  return "";
}

function tell(box, note, text) {
  note.textContent = text;
  note.hidden = !text;
  box.classList.toggle("wrong", Boolean(text));
}

// The server's complaint beside the field that it names; false if it names none.
function tellBeside(message) {
  const notes = [...document.querySelectorAll("#controls p")];
  const note = notes.find(note => message.includes(`${note.id.slice("note-".length)}: `));
  if (note) tell(note.parentElement.querySelector("input[type=number]"), note, message.split(": ").slice(-1)[0]);
  return Boolean(note);
}

function clearNotes() {
  for (const note of document.querySelectorAll("#controls p")) {
    tell(note.parentElement.querySelector("input[type=number]"), note, "");
  }
}

function showChoices(choices, settings, changed) {
  byId("choices").replaceChildren(...Object.entries(choices).map(([key, names]) => createElement("label", {}, key,
    createElement("select", { id: `choice-${key}`, onchange: event => changed(key, event.target.value) },
      ...names.map(name => createElement("option", { value: name, selected: settings[key] === name }, name))))));
}

// Whether a group of the card is open, as it was left.
const openGroups = new Map();

// Every field of a point, by group; `missing` says why there is none.
function showCard(frame, index, { origin, closed, missing }) {
  const card = byId("card");
  card.hidden = false;
  const close = createElement("button", { type: "button", ariaLabel: "close", onclick: closed }, "✕");
  if (index < 0) {
    card.replaceChildren(close, missing);
    return;
  }
  const groups = [];
  for (const group of frame.groups) {
    const fields = frame.fields.filter(field => field.group === group);
    if (!fields.length) continue;
    const rows = [];
    for (const field of fields) {
      const value = frame.values(field.name)[index] + ("xyz".includes(field.name) ? origin["xyz".indexOf(field.name)] : 0);
      const text = field.names ? field.names[value] ?? (value < 0 ? "none" : String(value))
        : field.unit === "m" && Number.isFinite(value) ? `${value.toFixed(4)}\u202fm` : formatted(value, field.unit);
      rows.push(createElement("tr", { title: field.meaning },
        createElement("td", {}, field.label, createElement("i", {}, field.symbol)), createElement("td", {}, text)));
    }
    // The first group is open, the others on a click, so that the card leaves the picture free.
    const open = openGroups.get(group) ?? !groups.length;
    groups.push(createElement("details", { open, ontoggle: event => openGroups.set(group, event.target.open) },
      createElement("summary", {}, group), createElement("table", {}, createElement("tbody", {}, ...rows))));
  }
  card.replaceChildren(close, createElement("p", {}, note(frame, index)), ...groups);
}

// What a budget lacks.
function note(frame, index) {
  if (!frame.arrays.echo_power) return frame.command ? "" : "For P_r, P_rs and the threshold: lidarscene view CLOUD SCENE, of a cloud with truth.";
  return frame.approximate?.includes(frame.arrays.material[index])
    ? "This material is not Lambertian: P_rs, and what follows from it, are those of its diffuse part." : "";
}
