//! The viewer in the browser.

mod assets;
mod server;
mod source;
mod wire;

use std::{
    net::{IpAddr, Ipv4Addr, TcpListener},
    path::PathBuf,
    sync::mpsc,
    thread,
};

use cape_infer::Run;
use clap::Args;
use serde::Serialize;

use crate::{
    console::Console,
    error::{Context, Error, Result},
    options::{GlobalArgs, positive},
    page_server::token,
};
use server::ServerState;
use source::{MeshSource, RunSource, Source};

/// View dressed bodies in the browser; change code, shape, pose and outfit.
///
/// Serves a page to this machine only, at an address with a secret token, until Ctrl-C.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  cape view runs/cape\n  cape view dressed.obj\n  \
                        cape view frames --fps 15 --no-open --port 8080")]
pub(crate) struct ViewArgs {
    /// Run, mesh (.obj, .ply), SMPL body (.npz, .pkl), or directory of meshes as a sequence.
    #[arg(value_name = "RUN|MESH|SEQUENCE")]
    path: PathBuf,
    /// Port to listen on; 0 selects a free one.
    #[arg(long, default_value_t = 0, value_name = "PORT")]
    port: u16,
    /// Address to listen on.
    #[arg(long, default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST), value_name = "ADDRESS", hide = true)]
    address: IpAddr,
    /// Frames per second of a sequence.
    #[arg(long, default_value_t = 30.0, value_name = "FPS", value_parser = positive)]
    fps: f64,
    /// Do not open the browser.
    #[arg(long)]
    no_open: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    url: String,
}

impl ViewArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        if !self.address.is_loopback() {
            return Err(Error::message(format!(
                "--address {}: expected a loopback address, such as 127.0.0.1",
                self.address
            )));
        }
        let device = global.device()?;
        let run = if self.path.join("config.toml").exists() {
            Some(Run::open(&self.path, &device)?)
        } else {
            None
        };
        let source = match &run {
            Some(run) => Source::Model(Box::new(RunSource::new(run, console))),
            None => Source::Meshes(MeshSource::open(&self.path, self.fps)?),
        };
        let scene = source.scene()?.to_string();
        let faces = source.faces().as_flattened().iter().flat_map(|i| i.to_le_bytes()).collect();

        let address = (self.address, self.port);
        let listener = TcpListener::bind(address)
            .map_err(|error| Error::io("socket", error))
            .doing(|| format!("listening on port {}", self.port))?;
        let address = listener.local_addr().map_err(|error| Error::io("socket", error))?;
        let (jobs, list) = mpsc::channel();
        let token = token();
        let report = Report { url: format!("http://{address}/{token}/") };
        let site = ServerState { token, scene, faces, port: address.port(), jobs };
        let server = thread::spawn(move || server::serve(listener, site));
        console.result(&report, || format!("{}\npress Ctrl-C to stop", report.url))?;
        if !self.no_open && open::that_detached(&report.url).is_err() {
            console.note("cannot open a browser: open the address by hand");
        }
        server::work(list, |question| source.answer(question), |download| source.file(download));
        server.join().map_err(|_| Error::message("internal error: the server thread failed"))?
    }
}
