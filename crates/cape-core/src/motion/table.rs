//! Rows of numbers in text.

use std::io::BufRead;

use crate::{Error, Result};

/// Rows of numbers of a text, one for each frame, read one by one.
///
/// Numbers are separated by commas, semicolons, tabs or spaces; empty lines, comments after `#` and
/// a first line of names are skipped.
///
/// ```
/// use cape_core::motion::MotionRows;
///
/// let text = "x,y\n1,2\n\n3,4\n";
/// let rows: Vec<Vec<f64>> = MotionRows::new("table.csv", text.as_bytes()).collect::<Result<_, _>>()?;
/// assert_eq!(rows, [[1.0, 2.0], [3.0, 4.0]]);
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug)]
pub struct MotionRows<R> {
    name: String,
    lines: std::io::Lines<R>,
    line: usize,
    width: Option<usize>,
    started: bool,
}

impl<R: BufRead> MotionRows<R> {
    /// Rows of `text`, which errors call `name`.
    pub fn new(name: impl Into<String>, text: R) -> Self {
        Self { name: name.into(), lines: text.lines(), line: 0, width: None, started: false }
    }

    fn error(&self, message: impl Into<String>) -> Error {
        Error::field(&self.name, format!("line {}", self.line), message)
    }

    fn row(&mut self, text: &str) -> Option<Result<Vec<f64>>> {
        let content = text.trim_start_matches('\u{feff}').split('#').next().unwrap_or_default();
        let cells = content.split([',', ';', '\t', ' ']).map(str::trim);
        let cells: Vec<&str> = cells.filter(|cell| !cell.is_empty()).collect();
        if cells.is_empty() {
            return None;
        }
        let first = !std::mem::replace(&mut self.started, true);
        let numbers: Result<Vec<f64>, _> = cells.iter().map(|cell| cell.parse()).collect();
        let row = match numbers {
            Ok(row) => row,
            Err(_) if first => return None,
            Err(_) => return Some(Err(self.error("expected numbers separated by commas"))),
        };
        if let Some(at) = row.iter().position(|x: &f64| !x.is_finite()) {
            return Some(Err(self.error(format!("number {} is not finite", at + 1))));
        }
        let width = *self.width.get_or_insert(row.len());
        if row.len() != width {
            let message = format!("{} numbers, expected {width} as in the row before", row.len());
            return Some(Err(self.error(message)));
        }
        Some(Ok(row))
    }
}

impl<R: BufRead> Iterator for MotionRows<R> {
    type Item = Result<Vec<f64>>;

    fn next(&mut self) -> Option<Result<Vec<f64>>> {
        loop {
            let text = match self.lines.next()? {
                Ok(text) => text,
                Err(error) => return Some(Err(Error::io(&self.name, error))),
            };
            self.line += 1;
            if let Some(row) = self.row(&text) {
                return Some(row);
            }
        }
    }
}
