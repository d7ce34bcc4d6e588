use std::collections::BTreeMap;

use serde::{Serialize, Serializer};
use serde_json::Value;

use crate::table::Table;

/// Kind of a file or directory, and named values in order.
#[derive(Debug, Clone)]
pub(super) struct FileSummary {
    kind: &'static str,
    entries: Vec<(String, Value)>,
}

impl FileSummary {
    pub(super) fn new(kind: &'static str) -> Self {
        Self { kind, entries: Vec::new() }
    }

    /// Adds a value.
    pub(super) fn with(mut self, name: impl Into<String>, value: impl Into<Value>) -> Self {
        self.entries.push((name.into(), value.into()));
        self
    }

    /// Adds a value if there is one.
    pub(super) fn maybe(self, name: impl Into<String>, value: Option<impl Into<Value>>) -> Self {
        match value {
            Some(value) => self.with(name, value),
            None => self,
        }
    }

    pub(super) fn text(&self) -> String {
        let mut table = Table::default();
        for (name, value) in &self.entries {
            table.row([name.as_str(), &said(value)]);
        }
        format!("{}\n\n{}", self.kind, table.text())
    }
}

impl Serialize for FileSummary {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map: BTreeMap<&str, &Value> =
            self.entries.iter().map(|(name, value)| (name.as_str(), value)).collect();
        let kind = Value::from(self.kind);
        map.insert("kind", &kind);
        map.serialize(serializer)
    }
}

/// A value without the punctuation of JSON.
fn said(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Array(values) => values.iter().map(said).collect::<Vec<_>>().join(" "),
        Value::Bool(true) => "yes".into(),
        Value::Bool(false) => "no".into(),
        other => other.to_string(),
    }
}
