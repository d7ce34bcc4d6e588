//! The page, part of the program.

pub(super) const PAGE: &str = include_str!("web/index.html");

macro_rules! files {
    ($($kind:literal: $($name:literal)*;)*) => {
        &[$($(($name, $kind, include_str!(concat!("web/", $name)))),*),*]
    };
}

/// Modules of the exported page: name and text.
pub(super) const SITE_FILES: &[(&str, &str)] = &[
    ("garments.js", include_str!("web/site/garments.js")),
    ("glb.js", include_str!("web/site/glb.js")),
    ("local.js", include_str!("web/site/local.js")),
    ("mesh_file.js", include_str!("web/site/mesh_file.js")),
    ("prior.js", include_str!("web/site/prior.js")),
    ("random.js", include_str!("web/site/random.js")),
    ("site.js", include_str!("web/site/site.js")),
    ("skeleton.js", include_str!("web/site/skeleton.js")),
    ("worker.js", include_str!("web/site/worker.js")),
];

/// Name, type and text.
const FILES: &[(&str, &str, &str)] = files! {
    "text/css; charset=utf-8": "viewer.css";
    "text/javascript; charset=utf-8":
        "answer.js" "camera.js" "colours.js" "controls.js" "gestures.js" "keys.js" "legend.js"
        "link.js" "main.js" "matrix.js" "mesh.js" "panel.js" "player.js" "save.js" "scene.js" "server.js" "shaders.js"
        "shadows.js" "viewer.js" "words.js";
};

/// A part of the page by its name: type and text.
pub(super) fn find(name: &str) -> Option<(&'static str, &'static str)> {
    FILES.iter().find(|(known, ..)| *known == name).map(|&(_, kind, text)| (kind, text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_module_that_is_imported_is_there() {
        for (name, _, text) in FILES {
            for import in text.split(" from \"./").skip(1) {
                let module = import.split('"').next().unwrap_or_default();
                assert!(find(module).is_some(), "{name} imports {module}");
            }
        }
        for part in PAGE.split("src=\"").skip(1) {
            let script = part.split('"').next().unwrap_or_default();
            assert!(find(script).is_some(), "the page needs {script}");
        }
    }
}
