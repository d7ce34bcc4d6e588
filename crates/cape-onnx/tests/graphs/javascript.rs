//! The modules in JavaScript, in Node.

use std::{
    ffi::OsString,
    fs,
    path::Path,
    process::{Command, Output},
};

use base64::{Engine, engine::general_purpose::STANDARD};
use cape_onnx::{JAVASCRIPT, WeightPrecision, export_body, export_model};
use serde_json::{Map, json};

use crate::{
    BATCHES,
    models::{cases, expected},
};

/// Runs a script beside the modules; `None` without Node.
fn node(place: &Path, script: &str, arguments: &[&str]) -> Option<Output> {
    for (name, text) in JAVASCRIPT {
        fs::write(place.join(name), text).unwrap();
    }
    fs::write(place.join("package.json"), r#"{"type":"module"}"#).unwrap();
    fs::write(place.join("script.js"), script).unwrap();
    let program = std::env::var_os("CAPE_NODE").unwrap_or_else(|| OsString::from("node"));
    match Command::new(program).arg("script.js").args(arguments).current_dir(place).output() {
        Ok(output) => Some(output),
        Err(error) => {
            println!("SKIPPED: Node cannot be started: {error}");
            None
        }
    }
}

#[test]
fn graphs_give_the_same_results_in_javascript() {
    let place = tempfile::tempdir().unwrap();
    let cases = cases();
    for (name, model, precision) in &cases {
        let directory = place.path().join(name);
        fs::create_dir(&directory).unwrap();
        export_model(model, &directory, *precision).unwrap();
        for n in BATCHES {
            let arrays: Map<_, _> = expected(model, n)
                .into_iter()
                .map(|(name, array)| (name.to_owned(), json!(array.iter().collect::<Vec<_>>())))
                .collect();
            let path = directory.join(format!("batch-{n}.json"));
            fs::write(path, serde_json::to_vec(&arrays).unwrap()).unwrap();
        }
    }
    let names: Vec<&str> = cases.iter().map(|(name, ..)| *name).collect();
    let script = include_str!("clients/javascript_check.js");
    let Some(ran) = node(place.path(), script, &names) else { return };
    let said = String::from_utf8_lossy(&ran.stdout);
    println!("{said}");
    assert!(ran.status.success(), "{said}\n{}", String::from_utf8_lossy(&ran.stderr));
    assert_eq!(said.lines().filter(|line| line.starts_with("ok ")).count(), 3 * cases.len());
}

#[test]
fn damaged_graphs_are_refused_in_javascript() {
    let place = tempfile::tempdir().unwrap();
    let body = cape_synth::synthetic_body();
    let mask = cape_core::ClothingMask::from_weights(&body).unwrap();
    let graph = export_body(&body, &mask, WeightPrecision::Half).unwrap().encode();
    fs::write(place.path().join("smpl.onnx"), graph).unwrap();
    let script = r#"
import { readFileSync } from "node:fs";
import { Graph } from "./graph.js";

const bytes = new Uint8Array(readFileSync("smpl.onnx"));
const refused = work => {
  try {
    work();
    return 0;
  } catch (error) {
    return Number(error instanceof Error);
  }
};
const cut = [0, 1, 2, 3, 10, 1000, bytes.length / 2, bytes.length - 1].map(Math.floor);
console.log(cut.filter(length => refused(() => new Graph(bytes.subarray(0, length)))).length, cut.length);
const graph = new Graph(bytes);
console.log(refused(() => graph.run({})), refused(() => graph.run({ betas: new Float32Array(7) })));
"#;
    let Some(ran) = node(place.path(), script, &[]) else { return };
    let said = String::from_utf8_lossy(&ran.stdout);
    assert_eq!(said, "8 8\n1 1\n", "{}", String::from_utf8_lossy(&ran.stderr));
}

#[test]
fn the_code_of_products_is_made_of_its_text() {
    let code = wat::parse_str(include_str!("../../web/products.wat")).unwrap();
    let (_, script) = JAVASCRIPT.into_iter().find(|(name, _)| *name == "products.js").unwrap();
    let lines = script.lines().filter_map(|line| line.strip_prefix("  \"")?.strip_suffix("\","));
    let used = STANDARD.decode(lines.collect::<String>()).unwrap();
    // What is left is the section of names, which has the number 0.
    let same = code.starts_with(&used) && code[used.len()] == 0;
    assert!(same, "put the code into products.js: {}", STANDARD.encode(code));
}
