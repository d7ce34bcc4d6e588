//! The report as one HTML file.

use std::fmt::Write as _;

use base64::{Engine, engine::general_purpose::STANDARD};
use cape_render::Image;
use cape_train::{comparison::Table, table2::Grid};

use crate::{
    console::seconds,
    error::{Error, Result},
};

const STYLE: &str = "body{font:16px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:72rem;padding:0 \
1rem;color:#222;background:#fff}table{border-collapse:collapse;margin:1rem 0;font-variant-numeric:\
tabular-nums}th,td{padding:.3rem .7rem;border-bottom:1px solid #ddd;text-align:right;white-space:nowrap}th{white-space:normal;vertical-align:bottom}p{overflow-wrap:anywhere}th:first-child,\
td:first-child{text-align:left}div.wide{overflow-x:auto}img{max-width:100%}figure{margin:1rem 0}figcaption{color:#777}pre{background:#f5f5f6;\
padding:1rem;overflow-x:auto}tr.reference{background:#f0f6ff}@media(prefers-color-scheme:dark){body{color:\
#ddd;background:#17181a}th,td{border-color:#3a3b3e}pre{background:#222326}img{filter:brightness(.85)}tr.reference{background:#1d2733}}";

/// A picture of the report.
pub(super) struct Figure<'a> {
    pub(super) title: &'a str,
    pub(super) caption: &'a str,
    pub(super) image: &'a Image,
}

/// Tables, figures, configuration, versions and the data's hash, all in one text.
pub(super) fn html(table: &Table, grid: &Grid, figures: &[Figure]) -> Result<String> {
    let mut body = String::new();
    let (header, rows) = table.rows();
    let class = |line| if table.is_reference(line) { "reference" } else { "" };
    let first = rows.iter().zip(&table.lines).map(|(cells, line)| (class(line), cells.to_vec()));
    body += &html_table(&header, first);
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
        let _ = writeln!(body, "<h2>{title}</h2>{}", html_table(&header, rows));
    }
    for Figure { title, caption, image } in figures {
        let mut png = Vec::new();
        image.encode(&mut png).map_err(|error| Error::io("report.html", error))?;
        let data = STANDARD.encode(&png);
        let _ = writeln!(
            body,
            "<h2>{title}</h2><figure><img alt=\"{title}\" \
             src=\"data:image/png;base64,{data}\"><figcaption>{}</figcaption></figure>",
            escaped(caption)
        );
    }
    let config = toml::to_string(&grid.config)
        .map_err(|error| Error::message(format!("settings: {error}")))?;
    let _ = writeln!(
        body,
        "<h2>How</h2><p>cape {} · data {} (SHA-256 {}) · trained in {}</p><pre>{}</pre>",
        env!("CARGO_PKG_VERSION"),
        escaped(&grid.data.display().to_string()),
        grid.data_hash,
        seconds(table.lines.iter().map(|line| line.seconds).sum()),
        escaped(&config)
    );
    Ok(format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" \
         content=\"width=device-width\"><title>CAPE, table 2</title><style>{STYLE}</style></head>\
         <body><h1>Reconstruction of held-out clothing</h1>\n{body}</body></html>\n"
    ))
}

fn html_table<'a>(header: &[String], rows: impl Iterator<Item = (&'a str, Vec<String>)>) -> String {
    let cells = |cells: &[String], tag: &str| -> String {
        let cell = |cell: &String| format!("<{tag}>{}</{tag}>", escaped(cell));
        cells.iter().map(cell).collect::<Vec<_>>().concat()
    };
    let mut text = format!("<div class=\"wide\"><table><tr>{}</tr>\n", cells(header, "th"));
    for (class, row) in rows {
        let class = if class.is_empty() { String::new() } else { format!(" class=\"{class}\"") };
        let _ = writeln!(text, "<tr{class}>{}</tr>", cells(&row, "td"));
    }
    text + "</table></div>"
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
