//! Plain text tables. comfy-table and tabled draw the rule of a header through the padding of its
//! cells; here two spaces part columns in header, rule and rows alike.

/// A plain table: columns separated by spaces, a rule under the header. Columns of numbers are
/// right-aligned.
#[derive(Debug, Clone, Default)]
pub(crate) struct Table {
    header: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    pub(crate) fn new<S: Into<String>>(header: impl IntoIterator<Item = S>) -> Self {
        Self { header: header.into_iter().map(Into::into).collect(), rows: Vec::new() }
    }

    pub(crate) fn row<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>) {
        self.rows.push(cells.into_iter().map(Into::into).collect());
    }

    /// The table as text, without a final line break.
    pub(crate) fn text(&self) -> String {
        let columns = self.rows.iter().map(Vec::len).max().unwrap_or(0).max(self.header.len());
        let mut widths = vec![0; columns];
        let mut numeric = vec![true; columns];
        for row in std::iter::once(&self.header).chain(&self.rows) {
            for (column, cell) in row.iter().enumerate() {
                widths[column] = widths[column].max(cell.chars().count());
            }
        }
        for row in &self.rows {
            for (column, cell) in row.iter().enumerate() {
                numeric[column] &= is_numeric(cell);
            }
        }
        let line = |row: &[String]| {
            let cells = (0..columns).map(|column| {
                let cell = row.get(column).map_or("", String::as_str);
                let width = widths[column];
                if numeric[column] { format!("{cell:>width$}") } else { format!("{cell:<width$}") }
            });
            cells.collect::<Vec<_>>().join("  ").trim_end().to_owned()
        };
        let mut lines = Vec::new();
        if !self.header.is_empty() {
            lines.push(line(&self.header));
            let rule: Vec<String> = widths.iter().map(|&width| "─".repeat(width)).collect();
            lines.push(rule.join("  "));
        }
        lines.extend(self.rows.iter().map(|row| line(row)));
        lines.join("\n")
    }
}

fn is_numeric(cell: &str) -> bool {
    cell.is_empty() || cell == "–" || cell.starts_with(|c: char| c.is_ascii_digit() || c == '-')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_right_aligned_and_names_left() {
        let mut table = Table::new(["outfit", "mm"]);
        table.row(["longlong", "3.25"]);
        table.row(["all", "12.50"]);
        assert_eq!(
            table.text(),
            "outfit       mm\n────────  ─────\nlonglong   3.25\nall       12.50"
        );
    }

    #[test]
    fn short_rows_are_padded() {
        let mut table = Table::default();
        table.row(["vertices", "4"]);
        table.row(["faces"]);
        assert_eq!(table.text(), "vertices  4\nfaces");
    }
}
