//! Tables as text, CSV and HTML.

use crate::{html, table};

/// A table of words and numbers.
pub(super) struct ReportTable {
    /// The name of its file.
    pub(super) name: &'static str,
    pub(super) title: String,
    pub(super) caption: String,
    pub(super) header: Vec<String>,
    pub(super) rows: Vec<Vec<String>>,
}

impl ReportTable {
    pub(super) fn text(&self) -> String {
        let mut text = table::Table::new(self.header.clone());
        for row in &self.rows {
            text.row(row.clone());
        }
        format!("{}\n\n{}", self.title, text.text())
    }

    pub(super) fn csv(&self) -> String {
        let line = |cells: &[String]| -> String {
            let cells: Vec<String> = cells.iter().map(|cell| quoted(cell)).collect();
            cells.join(",") + "\n"
        };
        line(&self.header) + &self.rows.iter().map(|row| line(row)).collect::<String>()
    }

    pub(super) fn html(&self) -> String {
        let rows = self.rows.iter().map(|row| ("", row.clone()));
        format!(
            "<h2>{}</h2>{}<p>{}</p>\n",
            html::escaped(&self.title),
            html::table(&self.header, rows),
            html::escaped(&self.caption)
        )
    }
}

/// A cell of CSV.
fn quoted(cell: &str) -> String {
    if cell.contains([',', '"', '\n']) {
        return format!("\"{}\"", cell.replace('"', "\"\""));
    }
    cell.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_with_commas_are_quoted() {
        let table = ReportTable {
            name: "t",
            title: "T".into(),
            caption: String::new(),
            header: vec!["a".into(), "b".into()],
            rows: vec![vec!["length 1, width 2".into(), "0.5".into()]],
        };
        assert_eq!(table.csv(), "a,b\n\"length 1, width 2\",0.5\n");
        assert!(table.html().contains("<td>length 1, width 2</td>"));
    }
}
