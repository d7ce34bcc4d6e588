//! Pages of a study, part of the program.

/// Style of both pages.
const STYLE: (&str, &str) = ("study.css", include_str!("../web/study.css"));
/// Screens of both pages.
const SCREENS: (&str, &str) = ("pair.js", include_str!("../web/pair.js"));

/// Files of the served page by name; `index.html` is the page.
pub const SERVED: [(&str, &str); 4] = [
    ("index.html", include_str!("../web/serve.html")),
    ("serve.js", include_str!("../web/serve.js")),
    STYLE,
    SCREENS,
];

/// Files of an exported study by name, with jsPsych and its licence.
pub(crate) const EXPORTED: [(&str, &str); 6] = [
    ("index.html", include_str!("../web/export.html")),
    ("export.js", include_str!("../web/export.js")),
    ("jspsych.js", include_str!("../web/jspsych.js")),
    ("jspsych-LICENSE.txt", include_str!("../web/jspsych-LICENSE.txt")),
    STYLE,
    SCREENS,
];
