use cape_train::TrainEvent;

use crate::error::{Error, Result};

/// Dashboard of a build without the feature `tui`; there is none.
#[derive(Debug)]
pub(crate) enum Dashboard {}

impl Dashboard {
    pub(crate) fn check() -> Result {
        Err(absent())
    }

    pub(crate) fn start(_title: &str, _epochs: usize) -> Result<Self> {
        Err(absent())
    }

    pub(crate) fn on_event(&mut self, _event: &TrainEvent) {
        match *self {}
    }

    pub(crate) fn asked_to_stop(&mut self) -> bool {
        match *self {}
    }
}

fn absent() -> Error {
    Error::message("--tui: this build has no dashboard: build cape with `--features tui`")
}

pub(crate) const fn ask_to_stop() -> bool {
    false
}

pub(crate) const fn restore() {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_says_how_to_build_it() {
        let error = Dashboard::start("run", 1).unwrap_err().to_string();
        assert!(error.contains("--features tui"), "{error}");
    }
}
