//! JavaScript modules as one classic script: pages that are opened as files may not load modules.

use std::collections::BTreeSet;

use crate::error::{Error, Result};

/// `entry` and all modules that it imports, each after those that it imports, as statements. `find` has
/// the text of a module by its name. Modules are written as those of this page are: imports of names in a
/// line each at the beginning, exports of declarations.
pub(super) fn bundle<'a>(entry: &str, find: &impl Fn(&str) -> Option<&'a str>) -> Result<String> {
    let mut script = String::from("\"use strict\";\nconst modules = {};\n");
    add(entry, find, &mut BTreeSet::new(), &mut script)?;
    Ok(script)
}

fn add<'a>(
    name: &str,
    find: &impl Fn(&str) -> Option<&'a str>,
    added: &mut BTreeSet<String>,
    script: &mut String,
) -> Result {
    if !added.insert(name.to_owned()) {
        return Ok(());
    }
    let text = find(name).ok_or_else(|| missing(name))?;
    let (mut body, mut exported) = (String::new(), Vec::new());
    for line in text.lines() {
        if let Some((names, module)) = import(line) {
            add(module, find, added, script)?;
            body.extend(["const ", names, " = modules[\"", module, "\"];\n"]);
        } else if let Some(declaration) = line.strip_prefix("export ") {
            exported.push(declared(declaration).ok_or_else(|| missing(line))?);
            body += declaration;
            body.push('\n');
        } else {
            body += line;
            body.push('\n');
        }
    }
    let exported = exported.join(", ");
    script.extend(["modules[\"", name, "\"] = (() => {\n", &body]);
    script.extend(["return { ", &exported, " };\n})();\n"]);
    Ok(())
}

fn missing(what: &str) -> Error {
    Error::message(format!("internal error: the page's script lacks `{what}`"))
}

/// Names and module of a line that imports.
fn import(line: &str) -> Option<(&str, &str)> {
    let (names, module) = line.strip_prefix("import ")?.split_once(" from \"")?;
    Some((names, module.trim_start_matches("./").strip_suffix("\";")?))
}

/// Name that a declaration begins with.
fn declared(declaration: &str) -> Option<&str> {
    let rest = declaration.strip_prefix("async ").unwrap_or(declaration);
    let rest = ["function ", "class ", "const "].iter().find_map(|kind| rest.strip_prefix(kind))?;
    let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
    (end > 0).then(|| &rest[..end])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modules_come_after_those_that_they_import() {
        let find = |name: &str| match name {
            "a.js" => Some("import { b, c } from \"./b.js\";\n\nb(c);\n"),
            "b.js" => {
                Some("import { D } from \"./d.js\";\nexport function b() {}\nexport const c = D;\n")
            }
            "d.js" => Some("export class D {}\n"),
            _ => None,
        };
        let script = bundle("a.js", &find).unwrap();
        let places = ["modules[\"d.js\"] =", "modules[\"b.js\"] =", "modules[\"a.js\"] ="]
            .map(|start| script.find(start).unwrap());
        assert!(places.is_sorted(), "{script}");
        assert!(script.contains("const { D } = modules[\"d.js\"];"), "{script}");
        assert!(script.contains("return { b, c };"), "{script}");
        assert!(!script.contains("import") && !script.contains("export"), "{script}");
        assert!(bundle("e.js", &find).is_err());
    }
}
