//! The dashboard of `cape train --tui`: progress, losses and their curves on the whole terminal.
//!
//! [`DashboardState`](state::DashboardState) gathers what training reports and [`draw`](draw::draw) lays it out;
//! neither touches the terminal. [`Dashboard`] does, in a thread of its own, so that keys and the
//! clock work during a step of minutes.
//!
//! Cargo's feature `tui` builds it; without, [`Dashboard::start`] says so.

#[cfg(feature = "tui")]
mod curve;
#[cfg(feature = "tui")]
mod draw;
#[cfg(feature = "tui")]
mod screen;
#[cfg(feature = "tui")]
mod state;

#[cfg(not(feature = "tui"))]
mod absent;

#[cfg(not(feature = "tui"))]
pub(crate) use absent::{Dashboard, ask_to_stop, restore};
#[cfg(feature = "tui")]
pub(crate) use screen::{Dashboard, ask_to_stop, restore};
