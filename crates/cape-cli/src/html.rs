//! Self-contained HTML reports: tables, figures and the page around them.

use std::fmt::Write as _;

use base64::{Engine, engine::general_purpose::STANDARD};
use cape_render::Image;

use crate::error::{Error, Result};

const STYLE: &str = "body{font:16px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:72rem;padding:0 \
1rem;color:#222;background:#fff}table{border-collapse:collapse;margin:1rem 0;font-variant-numeric:\
tabular-nums}th,td{padding:.3rem .7rem;border-bottom:1px solid #ddd;text-align:right;white-space:nowrap}th{white-space:normal;vertical-align:bottom}p{overflow-wrap:anywhere}th:first-child,\
td:first-child{text-align:left}div.wide{overflow-x:auto}img{max-width:100%}figure{margin:1rem 0}figcaption{color:#777}pre{background:#f5f5f6;\
padding:1rem;overflow-x:auto}tr.reference{background:#f0f6ff}@media(prefers-color-scheme:dark){body{color:\
#ddd;background:#17181a}th,td{border-color:#3a3b3e}pre{background:#222326}img{filter:brightness(.85)}tr.reference{background:#1d2733}}";

/// A picture of a report.
pub(crate) struct HtmlFigure<'a> {
    pub(crate) title: &'a str,
    pub(crate) caption: &'a str,
    pub(crate) image: &'a Image,
}

impl HtmlFigure<'_> {
    /// The picture under its title, with its caption.
    pub(crate) fn html(&self) -> Result<String> {
        let Self { title, caption, image } = self;
        let mut png = Vec::new();
        image.encode(&mut png).map_err(|error| Error::io("report.html", error))?;
        let data = STANDARD.encode(&png);
        let (title, caption) = (escaped(title), escaped(caption));
        Ok(format!(
            "<h2>{title}</h2><figure><img alt=\"{title}\" \
             src=\"data:image/png;base64,{data}\"><figcaption>{caption}</figcaption></figure>\n"
        ))
    }
}

/// The whole page: `body` under `heading`.
pub(crate) fn page(title: &str, heading: &str, body: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" \
         content=\"width=device-width\"><title>{}</title><style>{STYLE}</style></head>\
         <body><h1>{}</h1>\n{body}</body></html>\n",
        escaped(title),
        escaped(heading)
    )
}

/// A table of a header and rows, each with a CSS class, which may be empty.
pub(crate) fn table<'a>(
    header: &[String],
    rows: impl Iterator<Item = (&'a str, Vec<String>)>,
) -> String {
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

/// Text with HTML's special characters escaped.
pub(crate) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
