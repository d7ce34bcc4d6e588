//! The report as a self-contained HTML file.

use std::fmt::Write as _;

use cape_data::Split;
use cape_eval::{comparison::ComparisonTable, store::packed_set_sha256, table2::Table2Options};

use crate::{
    console::seconds,
    error::{Error, Result},
    html::{self, HtmlFigure, escaped},
};

/// Tables, figures, configuration, version and the hash of the data.
pub(super) fn page(
    table: &ComparisonTable,
    grid: &Table2Options,
    figures: &[HtmlFigure],
) -> Result<String> {
    let mut body = String::new();
    let (header, rows) = table.rows();
    let class = |line| if table.is_reference(line) { "reference" } else { "" };
    let first = rows.iter().zip(&table.lines).map(|(cells, line)| (class(line), cells.to_vec()));
    body += &html::table(&header, first);
    let _ = writeln!(body, "<p>{}</p>", escaped(&table.caption()));
    for (title, of) in [
        ("By outfit", table.lines.iter().map(|line| &line.outfits).collect::<Vec<_>>()),
        ("By sequence", table.lines.iter().map(|line| &line.sequences).collect()),
    ] {
        let Some(names) = of.first().filter(|names| !names.is_empty()) else { continue };
        let mut header = vec!["error, mm".to_owned()];
        header.extend(names.iter().map(|(name, _)| name.clone()));
        let rows = table.lines.iter().zip(&of).map(|(line, errors)| {
            let mut cells = vec![line.label.clone()];
            cells.extend(errors.iter().map(|(_, error)| format!("{error:.2}")));
            (class(line), cells)
        });
        let _ = writeln!(body, "<h2>{title}</h2>{}", html::table(&header, rows));
    }
    for figure in figures {
        body += &figure.html()?;
    }
    let data_hash = packed_set_sha256(&grid.data, &[Split::Train, Split::Test])?;
    let config = toml::to_string(&grid.config)
        .map_err(|error| Error::message(format!("settings: {error}")))?;
    let _ = writeln!(
        body,
        "<h2>Configuration</h2><p>cape {} · data {} (SHA-256 {}) · trained in {}</p><pre>{}</pre>",
        env!("CARGO_PKG_VERSION"),
        escaped(&grid.data.display().to_string()),
        data_hash,
        seconds(table.lines.iter().map(|line| line.seconds).sum()),
        escaped(&config)
    );
    Ok(html::page("CAPE, table 2", "Reconstruction of held-out clothing", &body))
}
