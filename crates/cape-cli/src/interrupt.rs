use std::{
    process,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use crate::{
    console::Console,
    dashboard,
    error::{Error, Result},
};

/// Request to stop, by Ctrl-C or a termination signal.
#[derive(Debug, Clone)]
pub(crate) struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// Handles interrupts: the first is recorded, the second ends the process.
    pub(crate) fn listen(console: Console) -> Result<Self> {
        let asked = Arc::new(AtomicBool::new(false));
        let seen = asked.clone();
        ctrlc::set_handler(move || {
            if seen.swap(true, Ordering::SeqCst) {
                dashboard::restore();
                process::exit(130);
            }
            if dashboard::ask_to_stop() {
                return;
            }
            console.note("\nfinishing the step and saving; interrupt again to stop at once");
        })
        .map_err(|error| Error::message(format!("cannot listen for Ctrl-C: {error}")))?;
        Ok(Self(asked))
    }

    pub(crate) fn was_asked(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}
