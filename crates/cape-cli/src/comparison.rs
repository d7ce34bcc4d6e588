//! Tables and histograms of commands that compare methods.

use std::path::Path;

use cape_eval::comparison::ComparisonTable;
use cape_render::{Image, Plot, Series};

use crate::{error::Result, files, table};

/// Share of every method's errors that the histogram's axis covers at least.
const SHARE: f64 = 0.99;

/// The table as text.
pub(crate) fn text(table: &ComparisonTable) -> String {
    let (header, rows) = table.rows();
    let mut text = table::Table::new(header);
    for row in rows {
        text.row(row);
    }
    format!("{}\n\n{}", text.text(), table.caption())
}

/// Writes the table as `name`.md, .csv and .tex.
pub(crate) fn write(out: &Path, name: &str, table: &ComparisonTable) -> Result {
    for (extension, text) in
        [("md", table.markdown()), ("csv", table.csv()), ("tex", table.latex())]
    {
        files::write_text(&out.join(format!("{name}.{extension}")), &text)?;
    }
    Ok(())
}

/// Densities of the errors, one curve per method.
pub(crate) fn histograms(table: &ComparisonTable) -> Result<Image> {
    let ends = table.lines.iter().map(|line| line.histogram.quantile(SHARE));
    let end = ends.fold(0.0, f64::max);
    let series = table
        .lines
        .iter()
        .map(|line| {
            let mut points = line.histogram.density();
            points.retain(|(error, _)| *error < end);
            Series { name: line.label.clone(), points }
        })
        .collect();
    let plot = Plot {
        title: "Errors of sampled reconstructions".into(),
        x_label: "distance at a clothing vertex, mm".into(),
        y_label: "share per mm".into(),
        log_y: false,
        series,
    };
    Ok(plot.draw(1100, 620)?)
}
