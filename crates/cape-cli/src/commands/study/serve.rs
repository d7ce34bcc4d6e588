use std::{
    net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener},
    path::PathBuf,
};

use cape_study::{StudyDesign, consent};
use clap::Args;
use serde::Serialize;

use super::{
    export::link,
    server::{self, Rater, StudyServer},
};
use crate::{
    console::Console,
    error::{Context, Error, Result},
    options::at_least_one,
};

/// Serve a study to raters and record their answers.
///
/// Prints a link for each rater and serves until Ctrl-C. An answer is written to STUDY/answers.jsonl at
/// once, with its time, window and raw clicks; a rater who reloads the page goes on where they were. The
/// links are kept in STUDY/raters.json. For raters elsewhere, put a web server with TLS in front and name
/// its address by --url.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape study serve study --raters 10\n  cape study serve study \
                        --port 8080 --url https://study.example.org"
)]
pub(crate) struct ServeArgs {
    /// Directory of a study, as written by `cape study make`.
    #[arg(value_name = "STUDY")]
    study: PathBuf,
    /// Number of raters; those of earlier calls keep their links.
    #[arg(long, default_value_t = 10, value_name = "N", value_parser = at_least_one)]
    raters: usize,
    /// Port to listen on; 0 selects a free one.
    #[arg(long, default_value_t = 0, value_name = "PORT")]
    port: u16,
    /// Address to listen on.
    #[arg(long, default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST), value_name = "ADDRESS")]
    address: IpAddr,
    /// Address by which raters reach the server [default: this machine's].
    #[arg(long, value_name = "URL", value_parser = link)]
    url: Option<String>,
    /// Page to go to at the end, such as Prolific's completion link.
    #[arg(long, value_name = "URL", value_parser = link)]
    completion: Option<String>,
}

#[derive(Debug, Serialize)]
struct Link {
    rater: String,
    url: String,
}

impl ServeArgs {
    pub(crate) fn run(self, console: Console) -> Result {
        if self.address.is_unspecified() && self.url.is_none() {
            return Err(Error::message(format!(
                "--address {}: expected --url too, the address by which raters reach the server",
                self.address
            )));
        }
        let design = StudyDesign::load(&self.study)?;
        let consent = consent(&self.study)?;
        let raters = Rater::of_study(&self.study, self.raters)?;
        let listener = TcpListener::bind((self.address, self.port))
            .map_err(|error| Error::io("socket", error))
            .doing(|| format!("listening on {} port {}", self.address, self.port))?;
        let port = listener.local_addr().map_err(|error| Error::io("socket", error))?.port();
        let base = match &self.url {
            Some(url) => url.trim_end_matches('/').to_owned(),
            None => format!("http://{}", SocketAddr::new(self.address, port)),
        };
        let origin = base.splitn(4, '/').take(3).collect::<Vec<_>>().join("/");
        let links: Vec<Link> = raters
            .iter()
            .map(|rater| Link {
                rater: rater.name.clone(),
                url: format!("{base}/{}/", rater.token),
            })
            .collect();
        let server =
            StudyServer::new(design, &self.study, raters, origin, (consent, self.completion))?;
        console.result(&links, || {
            let lines = links.iter().map(|link| format!("{}  {}", link.rater, link.url));
            format!("{}\npress Ctrl-C to stop", lines.collect::<Vec<_>>().join("\n"))
        })?;
        server::serve(listener, server)
    }
}
