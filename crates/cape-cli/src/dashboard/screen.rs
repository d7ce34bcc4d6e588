//! The dashboard on the terminal.

use std::{
    io::{self, BufWriter, IsTerminal, Stderr},
    panic, process,
    sync::{
        Arc, Mutex, MutexGuard, Once, PoisonError, TryLockError,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle, sleep},
    time::{Duration, Instant},
};

use cape_eval::bench::rss_mb;
use cape_train::TrainEvent;
use ratatui::{
    Terminal,
    backend::CrosstermBackend,
    crossterm::{
        cursor::Show,
        event::{self, KeyCode, KeyEvent, KeyModifiers},
        execute,
        terminal::{EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode},
    },
};

use super::{draw::draw, state::DashboardState};
use crate::error::{Error, Result};

/// Between two pictures.
const FRAME: Duration = Duration::from_millis(100);
/// Between two pictures that differ in the time only.
const IDLE: Duration = Duration::from_secs(1);

// A process has one terminal, which a panic or a signal has to find.
/// True while the dashboard has the terminal.
static SHOWN: AtomicBool = AtomicBool::new(false);
/// True if the user asked to stop.
static STOP: AtomicBool = AtomicBool::new(false);
/// Held while a picture is written.
static DRAWING: Mutex<()> = Mutex::new(());

/// The terminal taken over; dropping it gives the terminal back.
#[derive(Debug)]
pub(crate) struct Dashboard {
    state: Arc<Mutex<DashboardState>>,
    start: Instant,
    thread: Option<JoinHandle<()>>,
}

impl Dashboard {
    /// Returns an error if there can be no dashboard.
    pub(crate) fn check() -> Result {
        if io::stderr().is_terminal() {
            return Ok(());
        }
        Err(Error::message("--tui requires standard error to be a terminal"))
    }

    /// Takes over the terminal at standard error; standard output is left to the result.
    pub(crate) fn start(title: &str, epochs: usize) -> Result<Self> {
        Self::check()?;
        let terminal = enter_screen()
            .map_err(|error| Error::message(format!("--tui: terminal error: {error}")))?;
        let state = Arc::new(Mutex::new(DashboardState::new(title, epochs)));
        let (start, seen) = (Instant::now(), state.clone());
        let thread = thread::spawn(move || show(terminal, &seen, start));
        Ok(Self { state, start, thread: Some(thread) })
    }

    /// Records an event of training.
    pub(crate) fn on_event(&mut self, event: &TrainEvent) {
        let mut state = locked(&self.state);
        state.elapsed = self.start.elapsed();
        state.on_event(event);
    }

    /// True if the user asked to stop after this step.
    #[allow(clippy::unused_self, reason = "only who has the dashboard may ask it")]
    pub(crate) fn asked_to_stop(&mut self) -> bool {
        STOP.load(Ordering::SeqCst)
    }
}

impl Drop for Dashboard {
    fn drop(&mut self) {
        restore();
        if let Some(thread) = self.thread.take() {
            // A panic there has been reported by its hook.
            let _ = thread.join();
        }
    }
}

/// Says on the dashboard that training stops after its step; false if there is none.
pub(crate) fn ask_to_stop() -> bool {
    let shown = SHOWN.load(Ordering::SeqCst);
    if shown {
        STOP.store(true, Ordering::SeqCst);
    }
    shown
}

/// Gives the terminal back, if it was taken.
pub(crate) fn restore() {
    if !SHOWN.swap(false, Ordering::SeqCst) {
        return;
    }
    // A picture may be half written; but by a thread that panicked it is never finished.
    let mut guard = DRAWING.try_lock();
    for _ in 0..20 {
        if !matches!(guard, Err(TryLockError::WouldBlock)) {
            break;
        }
        sleep(FRAME / 10);
        guard = DRAWING.try_lock();
    }
    leave_screen();
}

fn leave_screen() {
    // Nothing can be done about a terminal that is gone.
    let _ = disable_raw_mode();
    let _ = execute!(io::stderr(), LeaveAlternateScreen, Show);
}

type Screen = Terminal<CrosstermBackend<BufWriter<Stderr>>>;

fn enter_screen() -> io::Result<Screen> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let previous = panic::take_hook();
        panic::set_hook(Box::new(move |panic| {
            restore();
            previous(panic);
        }));
    });
    STOP.store(false, Ordering::SeqCst);
    enable_raw_mode()?;
    let screen = execute!(io::stderr(), EnterAlternateScreen)
        .and_then(|()| Terminal::new(CrosstermBackend::new(BufWriter::new(io::stderr()))));
    match screen {
        Ok(_) => SHOWN.store(true, Ordering::SeqCst),
        Err(_) => leave_screen(),
    }
    screen
}

/// Draws and listens to keys until the terminal is given back.
fn show(mut screen: Screen, state: &Mutex<DashboardState>, start: Instant) {
    let mut drawn = None::<(Instant, Option<u64>, bool)>;
    while SHOWN.load(Ordering::SeqCst) {
        // A copy: training must not wait for a slow terminal.
        let now = {
            let mut state = locked(state);
            state.elapsed = start.elapsed();
            state.stopping = STOP.load(Ordering::SeqCst);
            state.clone()
        };
        let step = now.now.map(|now| now.total_step);
        let due = drawn.is_none_or(|(then, of, stopping)| {
            then.elapsed() >= IDLE || (of, stopping) != (step, now.stopping)
        });
        if due {
            if let Some(megabytes) = rss_mb() {
                locked(state).record_memory(megabytes);
            }
            let _guard = DRAWING.lock();
            if !SHOWN.load(Ordering::SeqCst) || screen.draw(|frame| draw(frame, &now)).is_err() {
                return;
            }
            drawn = Some((Instant::now(), step, now.stopping));
        }
        let frame = Instant::now();
        while let Some(rest) = FRAME.checked_sub(frame.elapsed()) {
            match event::poll(rest).and_then(|ready| ready.then(event::read).transpose()) {
                Ok(None) => {}
                Ok(Some(event)) => {
                    drawn = None;
                    if let Some(key) = event.as_key_press_event() {
                        press(key, &mut locked(state));
                    }
                }
                // A terminal without keys still shows.
                Err(_) => sleep(rest),
            }
        }
    }
}

/// Handles a key.
fn press(key: KeyEvent, state: &mut DashboardState) {
    match key.code {
        KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => {
            let asked_before = STOP.swap(true, Ordering::SeqCst);
            if asked_before {
                restore();
                process::exit(130);
            }
        }
        KeyCode::Char('q') => STOP.store(true, Ordering::SeqCst),
        KeyCode::Char('l') => state.logarithmic = !state.logarithmic,
        _ => {}
    }
}

fn locked(state: &Mutex<DashboardState>) -> MutexGuard<'_, DashboardState> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_ask_to_stop_and_change_the_scale() {
        let mut state = DashboardState::new("run", 1);
        press(KeyCode::Char('l').into(), &mut state);
        assert!(state.logarithmic);
        press(KeyCode::Char('x').into(), &mut state);
        assert!(!STOP.load(Ordering::SeqCst));
        press(KeyCode::Char('q').into(), &mut state);
        assert!(STOP.load(Ordering::SeqCst));
        // Nothing is shown, so that there is nobody to ask and nothing to restore.
        assert!(!ask_to_stop());
        restore();
    }
}
