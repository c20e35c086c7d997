//! The firmware as ARM code in QEMU, as the processor of a simulated rig.
//!
//! QEMU runs the image `pil` on the machine `netduinoplus2`, which has the rig's chip, in a folder of its own where the flash lies as a file.
//! Three lines lead to it: the link's serial port on a socket, the semihosting console on its standard streams for the simulated hardware, and
//! QEMU's monitor for the reset pin. All of it runs in lock step, so a busy computer makes it slower and changes nothing else.

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use firmware::device::DeviceInputs;
use firmware::device::exchange::{FRAME_BYTES, Frame, FromDevice, FromHost, InjectedFault};
use model_export::link::fault::Fault;
use model_export::link::state::ResetCause;

use super::lockstep::{Boot, Processor, Turn};
use super::{FlashMemory, LinkError};

/// The emulator.
pub const EMULATOR: &str = "qemu-system-arm";
/// The command that builds the image.
pub const BUILD: &str = "cargo build --release --target thumbv7em-none-eabihf -p firmware --bin pil";
/// Where that command leaves it, from the project's folder.
const IMAGE: &str = "target/thumbv7em-none-eabihf/release/pil";
/// Names another place for the image.
const IMAGE_VARIABLE: &str = "CATHETER_PIL_IMAGE";
const FLASH: &str = "flash.bin";

/// How to run the emulator.
#[derive(Clone, Debug)]
pub struct QemuConfig {
    /// The image.
    pub image: PathBuf,
    /// A processor that is silent for this long hangs. Not less than a self-test takes on a busy computer.
    pub hung_after: Duration,
}

impl QemuConfig {
    /// The image named on the command line or in the environment, or where cargo leaves it.
    ///
    /// # Errors
    /// When there is none, with the command that builds it.
    pub fn find(named: Option<&Path>) -> Result<Self, LinkError> {
        let variable = std::env::var_os(IMAGE_VARIABLE).map(PathBuf::from);
        let candidates: Vec<PathBuf> = match named.map(Path::to_path_buf).or(variable) {
            Some(path) => vec![path],
            None => usual_places(),
        };
        match candidates.iter().find(|path| path.is_file()) {
            Some(image) => {
                let image = std::path::absolute(image).unwrap_or_else(|_| image.clone());
                Ok(Self { image, hung_after: Duration::from_secs(20) })
            }
            None => Err(LinkError::Emulator(format!(
                "there is no image at {}; build it in the project's folder with `{BUILD}`, or name it with --image",
                candidates.first().map_or_else(|| IMAGE.to_owned(), |path| path.display().to_string())
            ))),
        }
    }
}

/// Below the working folder and every folder above it and above this program.
fn usual_places() -> Vec<PathBuf> {
    let here = std::env::current_dir().unwrap_or_default();
    let program = std::env::current_exe().unwrap_or_default();
    here.ancestors().chain(program.ancestors().skip(1)).map(|folder| folder.join(IMAGE)).collect()
}

/// QEMU with the image, between two resets.
pub struct Qemu {
    config: QemuConfig,
    child: Running,
    link: TcpStream,
    to_hardware: ChildStdin,
    from_hardware: Receiver<Frame>,
    monitor: TcpStream,
    folder: tempfile::TempDir,
    started: bool,
    /// It sent its boot request already.
    waiting: Option<Option<Fault>>,
}

impl Qemu {
    /// Starts the emulator with this flash.
    ///
    /// # Errors
    /// When QEMU is not there or does not start.
    pub fn start(config: QemuConfig, flash: &FlashMemory) -> Result<Self, LinkError> {
        let problem = |what: &str, error: &dyn std::fmt::Display| LinkError::Emulator(format!("{what}: {error}"));
        let folder =
            tempfile::Builder::new().prefix("catheter-qemu-").tempdir().map_err(|error| problem("no folder to work in", &error))?;
        std::fs::write(folder.path().join(FLASH), flash.to_bytes()).map_err(|error| problem("its flash cannot be written", &error))?;
        let listen = || TcpListener::bind(("127.0.0.1", 0)).map_err(|error| problem("no socket on this machine", &error));
        let (link, monitor) = (listen()?, listen()?);
        let mut command = Command::new(EMULATOR);
        command.args(["-M", "netduinoplus2", "-nographic", "-semihosting-config", "enable=on,target=native"]);
        for (name, listener) in [("link", &link), ("monitor", &monitor)] {
            let port = listener.local_addr().map_err(|error| problem("no socket on this machine", &error))?.port();
            command.arg("-chardev").arg(format!("socket,id={name},host=127.0.0.1,port={port},nodelay=on"));
        }
        command.args(["-serial", "chardev:link", "-mon", "chardev=monitor,mode=readline", "-kernel"]).arg(&config.image);
        command.current_dir(folder.path()).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let child = command.spawn().map_err(|error| match error.kind() {
            ErrorKind::NotFound => LinkError::Emulator(format!(
                "{EMULATOR} is not installed; `cargo xtask setup` installs it where the package manager allows (Debian: `apt-get install {EMULATOR}`)"
            )),
            _ => problem(EMULATOR, &error),
        })?;
        let mut child = Running(child);
        let (link, monitor) = (accept(&link, &mut child.0)?, accept(&monitor, &mut child.0)?);
        link.set_nodelay(true)
            .and_then(|()| link.set_read_timeout(Some(config.hung_after)))
            .map_err(|error| problem("a socket", &error))?;
        let (Some(to_hardware), Some(output)) = (child.0.stdin.take(), child.0.stdout.take()) else {
            return Err(LinkError::Emulator("it has no standard streams".to_owned()));
        };
        let from_hardware = frames(output);
        Ok(Self { config, child, link, to_hardware, from_hardware, monitor, folder, started: false, waiting: None })
    }

    /// Sends frame and link bytes for a tick and reads what comes of it.
    fn exchange(&mut self, frame: &FromHost, from_host: &[u8], to_host: &mut Vec<u8>) -> std::io::Result<Turn> {
        self.link.write_all(from_host)?;
        self.to_hardware.write_all(&frame.encode())?;
        match self.read_frame(self.config.hung_after)? {
            FromDevice::BootRequest { crash } => {
                self.waiting = Some(crash);
                Ok(Turn::Restarted)
            }
            FromDevice::Outputs(outputs) => {
                let at = to_host.len();
                to_host.resize(at + usize::from(outputs.link_bytes), 0);
                self.link.read_exact(&mut to_host[at..])?;
                Ok(Turn::Done(firmware::device::exchange::DeviceOutputs { link_bytes: 0, ..outputs }))
            }
        }
    }

    fn read_frame(&mut self, limit: Duration) -> std::io::Result<FromDevice> {
        let frame = self.from_hardware.recv_timeout(limit).map_err(|error| match error {
            RecvTimeoutError::Timeout => ErrorKind::TimedOut,
            RecvTimeoutError::Disconnected => ErrorKind::UnexpectedEof,
        })?;
        FromDevice::decode(&frame).ok_or_else(|| std::io::Error::new(ErrorKind::InvalidData, "the image lost step"))
    }

    /// Pulls the reset pin and waits for the processor to start.
    fn reset(&mut self) -> std::io::Result<FromDevice> {
        self.monitor.write_all(b"system_reset\n")?;
        let begun = Instant::now();
        loop {
            match self.read_frame(Duration::from_millis(50)) {
                Ok(FromDevice::Outputs(_)) => {}
                Err(error) if timed_out(&error) && begun.elapsed() < self.config.hung_after => {
                    // A processor that waits for its next tick keeps the emulator from looking at the pin; an empty frame wakes it.
                    self.to_hardware.write_all(&[0; FRAME_BYTES])?;
                }
                other => return other,
            }
        }
    }

    /// What to make of a broken socket: usually the emulator has ended and said why.
    fn gone(&mut self, error: &std::io::Error) -> LinkError {
        let _ = self.child.0.kill();
        let mut said = String::new();
        if let Some(mut stderr) = self.child.0.stderr.take() {
            let _ = stderr.read_to_string(&mut said);
        }
        let status = self.child.0.wait().map_or_else(|error| error.to_string(), |status| status.to_string());
        LinkError::Emulator(format!("it ended ({error}; {status}) {}", said.trim()))
    }
}

fn accept(listener: &TcpListener, child: &mut Child) -> Result<TcpStream, LinkError> {
    let failed = |error: std::io::Error| LinkError::Emulator(format!("a socket: {error}"));
    listener.set_nonblocking(true).map_err(failed)?;
    let begun = Instant::now();
    loop {
        match listener.accept() {
            Ok((stream, _)) => {
                stream.set_nonblocking(false).map_err(failed)?;
                return Ok(stream);
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(error) => return Err(failed(error)),
        }
        if let Ok(Some(status)) = child.try_wait() {
            let mut said = String::new();
            if let Some(stderr) = &mut child.stderr {
                let _ = stderr.read_to_string(&mut said);
            }
            return Err(LinkError::Emulator(format!("it ended at once ({status}): {}", said.trim())));
        }
        if begun.elapsed() > Duration::from_secs(20) {
            return Err(LinkError::Emulator("it does not open its serial ports".to_owned()));
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn timed_out(error: &std::io::Error) -> bool {
    matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock)
}

impl Processor for Qemu {
    fn boot(&mut self, boot: Boot) -> Result<Option<Fault>, LinkError> {
        // The first start came by itself, and so did a restart after a crash; any other reset is the reset pin's.
        let pulled = self.started && self.waiting.is_none();
        let request = match self.waiting.take() {
            Some(crash) => Ok(FromDevice::BootRequest { crash }),
            None if pulled => self.reset(),
            None => self.read_frame(self.config.hung_after),
        };
        let crash = match request {
            Ok(FromDevice::BootRequest { crash }) => crash,
            Ok(FromDevice::Outputs(_)) => return Err(LinkError::Emulator("the image lost step at its start".to_owned())),
            Err(error) if timed_out(&error) => {
                let image = self.config.image.display();
                return Err(LinkError::Emulator(format!("{image} does not start; is it the image `pil`? Build it with `{BUILD}`")));
            }
            Err(error) => return Err(self.gone(&error)),
        };
        self.started = true;
        let frame = FromHost::Boot { reset_cause: boot.reset_cause, line_bytes_per_tick: boot.line_bytes_per_tick }.encode();
        self.to_hardware.write_all(&frame).map_err(|error| self.gone(&error))?;
        Ok(crash)
    }

    fn tick(&mut self, inputs: DeviceInputs, from_host: &[u8], injected: InjectedFault, to_host: &mut Vec<u8>) -> Result<Turn, LinkError> {
        let link_bytes = u16::try_from(from_host.len()).map_err(|_| LinkError::Rig("more than 64 KiB for one tick".to_owned()))?;
        let before = to_host.len();
        match self.exchange(&FromHost::Inputs { inputs, link_bytes, injected }, from_host, to_host) {
            Ok(turn) => Ok(turn),
            Err(error) if timed_out(&error) => {
                to_host.truncate(before);
                Ok(Turn::Hung)
            }
            Err(error) => Err(self.gone(&error)),
        }
    }

    fn cause_of_restart(&self) -> ResetCause {
        ResetCause::Software
    }

    fn read_flash(&mut self) -> Result<FlashMemory, LinkError> {
        let bytes = std::fs::read(self.folder.path().join(FLASH)).map_err(|error| LinkError::Emulator(format!("its flash: {error}")))?;
        FlashMemory::from_bytes(&bytes).ok_or_else(|| LinkError::Emulator("its flash has another size".to_owned()))
    }
}

/// A child that ends with us.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Reads frames beside the rest, so that waiting for one can have an end.
fn frames(mut output: impl Read + Send + 'static) -> Receiver<Frame> {
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        let mut frame = [0; FRAME_BYTES];
        while output.read_exact(&mut frame).is_ok() && sender.send(frame).is_ok() {}
    });
    receiver
}
