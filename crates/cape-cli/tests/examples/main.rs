//! Every example in the help, the README and the book: all are parsed, and those that can run here are
//! run on small data under the names that they use.

#[path = "../cli/support.rs"]
#[allow(dead_code, reason = "shared with the tests of the commands")]
mod support;

mod example;
mod sandbox;

use std::{
    sync::{
        Mutex,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
};

use example::{Example, documents, from_documents, from_help};
use sandbox::Sandbox;

#[test]
fn examples_are_understood() {
    let examples = [from_help(), from_documents()].concat();
    assert!(examples.len() > 80, "{} examples", examples.len());
    let faults: Vec<String> = examples.iter().filter_map(|example| example.parse().err()).collect();
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn commands_named_in_the_text_exist() {
    let mut faults = Vec::new();
    for (name, text) in documents() {
        for code in text.split('`').skip(1).step_by(2) {
            let words = code.split_whitespace();
            if let Some(fault) = example::unknown_command(words) {
                faults.push(format!("{name}: `{code}`: {fault}"));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn examples_run() {
    let examples: Vec<Example> = {
        let mut examples = [from_help(), from_documents()].concat();
        examples.sort_by(|a, b| a.line.cmp(&b.line));
        examples.dedup_by(|a, b| a.line == b.line);
        examples.into_iter().filter(|example| example.reason_not_to_run().is_none()).collect()
    };
    let sandbox = Sandbox::new();
    let (next, faults) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    thread::scope(|scope| {
        for _ in 0..thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(|| {
                while let Some(example) = examples.get(next.fetch_add(1, Ordering::Relaxed)) {
                    if let Err(fault) = sandbox.run(example) {
                        faults.lock().unwrap().push(fault);
                    }
                }
            });
        }
    });
    let faults = faults.into_inner().unwrap();
    assert!(faults.is_empty(), "{}", faults.join("\n\n"));
}
