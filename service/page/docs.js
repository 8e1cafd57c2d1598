// The API's reference, made from /openapi.json.

const element = (tag, properties = {}, ...children) => {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children.filter((child) => child !== null));
  return made;
};

const api = await (await fetch("/openapi.json")).json();
const follow = (schema) => schema?.$ref ? schema.$ref.split("/").slice(1).reduce((found, key) => found[key], api) : schema ?? {};

// Markdown of one kind only: `code`.
const prose = (text) => element("p", {}, ...(text ?? "").split("`").map((part, i) => i % 2 ? element("code", { textContent: part }) : part));

function typeOf(schema) {
  const found = follow(schema);
  const choices = (found.anyOf ?? found.oneOf ?? []).filter((one) => one.type !== "null");
  if (choices.length) return choices.map(typeOf).join(" or ");
  if (found.enum) return found.enum.join(" · ");
  if (found.const !== undefined) return String(found.const);
  if (found.type === "array") return `${found.minItems ? `${found.minItems} ` : ""}${typeOf(found.items)}s`;
  if (found.format === "binary") return "bytes";
  return found.type ?? "any";
}

function bounds(schema) {
  const { minimum, maximum, exclusiveMinimum, exclusiveMaximum } = schema;
  const low = minimum ?? exclusiveMinimum, high = maximum ?? exclusiveMaximum;
  if (low === undefined && high === undefined) return "";
  if (high === undefined) return exclusiveMinimum !== undefined ? `above ${low}` : `from ${low}`;
  return exclusiveMinimum !== undefined ? `between ${low} and ${high}` : `${low ?? ""} to ${high}`;
}

function field(name, schema, required) {
  const found = follow(schema);
  const about = schema.description ?? found.description ?? "";
  const value = schema.default ?? found.default;
  const fallback = value === undefined || value === null || typeof value === "object" ? "" : `default ${value}`;
  const notes = [bounds(found), fallback, required ? "required" : ""].filter(Boolean).join(", ");
  return element("tr", {}, element("td", {}, element("code", { textContent: name })), element("td", { textContent: typeOf(schema) }),
    element("td", {}, ...prose(about).childNodes, notes ? element("small", { textContent: `${about ? " · " : ""}${notes}` }) : ""));
}

function fields(schema, prefix = "") {
  const found = follow(schema), rows = [];
  for (const [name, part] of Object.entries(found.properties ?? {})) {
    rows.push(field(prefix + name, part, found.required?.includes(name)));
    const inner = follow(part), forms = inner.oneOf ?? inner.anyOf ?? [inner];
    for (const form of forms) if (follow(form).properties) rows.push(...fields(form, `${prefix}${name}.`));
  }
  return rows;
}

const section = (title, ...children) => children.length ? [element("h3", { textContent: title }), ...children] : [];

function answers(responses) {
  return element("table", {}, ...Object.entries(responses).map(([status, answer]) => element("tr", {},
    element("td", {}, element("code", { textContent: status })),
    element("td", { textContent: Object.keys(answer.content ?? {}).join(", ") }),
    element("td", {}, ...prose(answer.description).childNodes))));
}

function call(path, method, operation, id) {
  const parameters = (operation.parameters ?? []).filter((one) => one.in !== "path");
  const bodies = Object.entries(operation.requestBody?.content ?? {});
  const body = bodies.flatMap(([type, { schema }]) => {
    const rows = fields(schema);
    return [prose(`\`${type}\`${rows.length ? "" : ": the bytes"}`), ...(rows.length ? [element("table", {}, ...rows)] : [])];
  });
  return element("section", { className: "call", id },
    element("h2", {}, element("span", { className: "method", textContent: method.toUpperCase() }), path),
    prose(operation.description ?? operation.summary),
    ...section("Query", ...(parameters.length ? [element("table", {}, ...parameters.map((one) => field(one.name, { ...one.schema, description: one.description ?? one.schema.description }, one.required)))] : [])),
    ...section("Body", ...body),
    ...section("Answers", answers(operation.responses)));
}

const groups = new Map();
for (const [path, operations] of Object.entries(api.paths)) {
  for (const [method, operation] of Object.entries(operations)) {
    const tag = operation.tags?.[0] ?? "other";
    groups.set(tag, [...(groups.get(tag) ?? []), { path, method, operation, id: operation.operationId }]);
  }
}
const contents = document.getElementById("contents"), calls = document.getElementById("calls");
calls.replaceChildren(prose(api.info.description));
for (const [tag, items] of groups) {
  contents.append(element("b", { textContent: tag }));
  for (const { path, method, operation, id } of items) {
    contents.append(element("a", { href: `#${id}` }, element("span", { className: "method", textContent: method.toUpperCase() }), element("span", { textContent: path })));
    calls.append(call(path, method, operation, id));
  }
}
