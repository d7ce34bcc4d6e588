//! Servers of the command.

use std::{
    ffi::OsStr,
    io::{BufRead, BufReader},
    process::{Child, Stdio},
};

use serde_json::Value;

use crate::support::cape;

/// Starts a server with `--json` and reads what it prints when it is ready.
pub(crate) fn serve<S: AsRef<OsStr>>(arguments: impl IntoIterator<Item = S>) -> (Child, Value) {
    let mut child = cape(arguments).arg("--json").stdout(Stdio::piped()).spawn().unwrap();
    let mut text = String::new();
    let mut out = BufReader::new(child.stdout.take().unwrap());
    while serde_json::from_str::<Value>(&text).is_err() {
        assert!(out.read_line(&mut text).unwrap() > 0, "no address: {text}");
    }
    (child, serde_json::from_str(&text).unwrap())
}
