"use strict";

// element("p", {className: "hint"}, "text", child, ...). Text is text whatever is in it: nothing here reads HTML.
function element(tag, properties, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties || {})) {
    if (name.startsWith("aria-") || name === "for") {
      made.setAttribute(name, value);
    } else {
      made[name] = value;
    }
  }
  for (const child of children) {
    if (child !== null && child !== undefined) made.append(child);
  }
  return made;
}

function button(text, title, action) {
  const made = element("button", {type: "button", title}, text);
  made.addEventListener("click", action);
  return made;
}

// A slider with its name and its value as text.
function slider(name, {min, max, step, value, id}, textOf, action) {
  const number = element("span", {className: "number"}, textOf(value));
  const input = element("input", {type: "range", min, max, step, value, id});
  input.addEventListener("input", () => {
    number.textContent = textOf(Number(input.value));
    action(Number(input.value));
  });
  return element("label", {}, name, input, number);
}

function section(title, hint, ...children) {
  return element("section", {className: "column"}, element("h2", {}, title), hint ? element("p", {className: "hint"}, hint) : null, ...children);
}
