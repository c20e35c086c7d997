//! What is computed of recordings: the tool's own commands, as processes of their own, with what they say while they run.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::{Arc, Mutex, PoisonError};

use serde::{Deserialize, Serialize};
use serde_json::Value;
use tokio::io::{AsyncRead, AsyncReadExt, BufReader};
use tokio::process::{Child, Command};
use tokio::sync::oneshot;

use crate::access::secret;
use crate::recorder::check_name;

/// Lines that are kept of a job.
const KEPT_LINES: usize = 200;
/// Longest line that is kept.
const LONGEST_LINE: usize = 400;

/// Which program computes, and what it can compute.
pub struct Jobs {
    /// The program, this one as a rule.
    pub program: PathBuf,
    /// What it can compute.
    pub kinds: Vec<JobKind>,
}

/// One of the tool's commands.
#[derive(Clone, Copy)]
pub struct JobKind {
    /// Its name.
    pub name: &'static str,
    /// What it answers.
    pub title: &'static str,
    /// Arguments for these recordings and this folder for what comes out, of one command after the other.
    pub arguments: fn(&[PathBuf], &Path) -> Vec<Vec<OsString>>,
    /// The report in that folder.
    pub report: &'static str,
    /// The model for the device in that folder, where one is made.
    pub model: Option<&'static str>,
    /// JSON in that folder with settings that belong to the model: an object `settings` of names and values.
    pub settings: Option<&'static str>,
}

/// What a client asks for.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Wanted {
    /// Name of a kind.
    pub kind: String,
    /// Names of recordings.
    pub recordings: Vec<String>,
}

/// A job as it is told.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Told {
    pub number: u32,
    pub kind: &'static str,
    pub recordings: Vec<String>,
    pub running: bool,
    /// The last words of what it said.
    pub lines: Vec<String>,
    pub exit_code: Option<i32>,
    /// Where its report is.
    pub report: Option<String>,
    /// Whether it made a model for the device.
    pub model: bool,
}

/// What a job made for the device.
pub(crate) struct Made {
    model: PathBuf,
    settings: Option<PathBuf>,
}

/// A model's bytes, and the settings that belong to it by name.
type ModelWithSettings = (Vec<u8>, Vec<(String, Value)>);

impl Made {
    /// The model, and the settings that belong to it.
    pub fn read(self) -> Result<ModelWithSettings, String> {
        let read = |path: &Path| std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()));
        let model = read(&self.model)?;
        let Some(path) = self.settings else { return Ok((model, Vec::new())) };
        let mut result: Value = serde_json::from_slice(&read(&path)?).map_err(|error| format!("{}: {error}", path.display()))?;
        let Value::Object(settings) = result["settings"].take() else { return Err(format!("{}: has no settings", path.display())) };
        Ok((model, settings.into_iter().collect()))
    }
}

struct Job {
    told: Told,
    kind: JobKind,
    folder: PathBuf,
    secret: String,
    end: Option<oneshot::Sender<()>>,
}

/// Runs one job at a time: it shares the machine with the session.
#[derive(Clone)]
pub(crate) struct Runner {
    jobs: Arc<Jobs>,
    folder: Arc<PathBuf>,
    done: Arc<Mutex<Vec<Job>>>,
    /// Other pages that may be opened, by their secrets.
    published: Arc<Mutex<Vec<(String, PathBuf)>>>,
}

impl Runner {
    pub fn new(jobs: Jobs, folder: PathBuf) -> Self {
        Self { jobs: Arc::new(jobs), folder: Arc::new(folder), done: Arc::default(), published: Arc::default() }
    }

    /// Name and title of each kind.
    pub fn kinds(&self) -> Vec<(&'static str, &'static str)> {
        self.jobs.kinds.iter().map(|kind| (kind.name, kind.title)).collect()
    }

    fn all(&self) -> std::sync::MutexGuard<'_, Vec<Job>> {
        self.done.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Every job so far.
    pub fn told(&self) -> Vec<Told> {
        self.all().iter().map(|job| job.told.clone()).collect()
    }

    /// The report whose address has this secret.
    pub fn report(&self, secret: &str) -> Option<PathBuf> {
        let of_job = self.all().iter().find(|job| job.secret == secret).map(|job| job.folder.join(job.kind.report));
        let published = self.published.lock().unwrap_or_else(PoisonError::into_inner);
        of_job.or_else(|| published.iter().find(|(known, _)| known == secret).map(|(_, path)| path.clone()))
    }

    /// Lets a page be opened at the address that is given back.
    pub fn publish(&self, path: PathBuf) -> Result<String, getrandom::Error> {
        let secret = secret()?;
        self.published.lock().unwrap_or_else(PoisonError::into_inner).push((secret.clone(), path));
        Ok(format!("/reports/{secret}"))
    }

    /// What a job made for the device.
    pub fn result(&self, number: u32) -> Result<Made, String> {
        let jobs = self.all();
        let job = jobs.iter().find(|job| job.told.number == number).ok_or("there is no such computation")?;
        let model = job.kind.model.filter(|_| job.told.model).ok_or("this computation made no model for the device")?;
        Ok(Made { model: job.folder.join(model), settings: job.kind.settings.map(|name| job.folder.join(name)) })
    }

    /// Ends the job that runs.
    pub fn end(&self) -> bool {
        let end = self.all().last_mut().filter(|job| job.told.running).and_then(|job| job.end.take());
        end.is_some_and(|end| end.send(()).is_ok())
    }

    /// Begins a job.
    pub fn begin(&self, wanted: &Wanted) -> Result<Told, String> {
        let kind = *self.jobs.kinds.iter().find(|kind| kind.name == wanted.kind).ok_or("there is no such computation")?;
        if wanted.recordings.is_empty() {
            return Err("choose a recording first".to_owned());
        }
        let mut paths = Vec::new();
        for name in &wanted.recordings {
            paths.push(recording_path(&self.folder, name).ok_or_else(|| format!("there is no recording {name}"))?);
        }
        let mut jobs = self.all();
        if jobs.last().is_some_and(|job| job.told.running) {
            return Err("a computation runs already; wait for it or end it".to_owned());
        }
        let number = u32::try_from(jobs.len()).unwrap_or(u32::MAX).saturating_add(1);
        // Those of an earlier run stay.
        let folder = (0u32..).map(|nth| self.folder.join(format!("{}-{}", kind.name, nth + number))).find(|folder| !folder.exists());
        let folder = folder.ok_or("there are too many results")?;
        let told = Told {
            number,
            kind: kind.name,
            recordings: wanted.recordings.clone(),
            running: true,
            lines: Vec::new(),
            exit_code: None,
            report: None,
            model: false,
        };
        let commands = (kind.arguments)(&paths, &folder);
        let first = self.spawn(commands.first().ok_or("there is nothing to compute")?)?;
        let (end, ended) = oneshot::channel();
        let secret = secret().map_err(|error| error.to_string())?;
        jobs.push(Job { told: told.clone(), kind, folder, secret, end: Some(end) });
        let at = jobs.len() - 1;
        drop(jobs);
        let runner = self.clone();
        tokio::spawn(async move { runner.run(at, first, &commands[1..], ended).await });
        Ok(told)
    }

    fn spawn(&self, arguments: &[OsString]) -> Result<Child, String> {
        let mut command = Command::new(&self.jobs.program);
        command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).kill_on_drop(true);
        command.spawn().map_err(|error| format!("{}: {error}", self.jobs.program.display()))
    }

    /// Runs one command after the other, as long as each succeeds and nobody ends them.
    async fn run(&self, at: usize, mut child: Child, rest: &[Vec<OsString>], mut ended: oneshot::Receiver<()>) {
        let mut rest = rest.iter();
        let code = loop {
            for stream in [child.stdout.take().map(boxed), child.stderr.take().map(boxed)].into_iter().flatten() {
                let runner = self.clone();
                tokio::spawn(async move { runner.read(at, stream).await });
            }
            let code = tokio::select! {
                status = child.wait() => status.ok().and_then(|status| status.code()),
                _ = &mut ended => { let _ = child.kill().await; None }
            };
            let next = if code == Some(0) { rest.next() } else { None };
            child = match next.map(|arguments| self.spawn(arguments)) {
                None => break code,
                Some(Ok(child)) => child,
                Some(Err(_)) => break None,
            };
        };
        if let Some(job) = self.all().get_mut(at) {
            job.told.running = false;
            job.told.exit_code = code;
            job.told.report = job.folder.join(job.kind.report).is_file().then(|| format!("/reports/{}", job.secret));
            job.told.model = code == Some(0) && job.kind.model.is_some_and(|model| job.folder.join(model).is_file());
        }
    }

    /// Keeps what a job says; a carriage return, as progress bars use it, writes over the line before.
    async fn read(&self, at: usize, stream: Box<dyn AsyncRead + Send + Unpin>) {
        let mut stream = BufReader::new(stream);
        let (mut line, mut over) = (Vec::new(), false);
        while let Ok(byte) = stream.read_u8().await {
            if !matches!(byte, b'\n' | b'\r') {
                if line.len() < LONGEST_LINE {
                    line.push(byte);
                }
                continue;
            }
            // Control characters are not for a page.
            let text: String = String::from_utf8_lossy(&line).chars().filter(|letter| !letter.is_control()).collect();
            line.clear();
            if let Some(job) = self.all().get_mut(at)
                && !text.is_empty()
            {
                if over {
                    job.told.lines.pop();
                }
                job.told.lines.push(text);
                if job.told.lines.len() > KEPT_LINES {
                    job.told.lines.remove(0);
                }
            }
            over = byte == b'\r';
        }
    }
}

fn boxed<T: AsyncRead + Send + Unpin + 'static>(stream: T) -> Box<dyn AsyncRead + Send + Unpin> {
    Box::new(stream)
}

/// The file of a recording in the folder; a name that leads elsewhere is none.
pub(crate) fn recording_path(folder: &Path, name: &str) -> Option<PathBuf> {
    let path = folder.join(format!("{name}.csv"));
    (check_name(name).is_ok() && path.is_file()).then_some(path)
}
