//! Listening to the device: its samples, what they end, and the points that they make room for.

use std::time::{Duration, Instant};

use anyhow::Result;
use dashboard::{Phase, Sample};
use model_export::link::message::Request;

use super::rig::OperatedRig;
use super::words;

impl OperatedRig {
    fn hear_of_points(&mut self) {
        if let Some(play) = &mut self.play
            && let Some(token) = play.waits_for()
            && let Some(reply) = self.client.take_reply(token)
        {
            play.take(&reply);
        }
    }

    pub(super) fn listen_to_all(&mut self, limit: Duration, into: &mut Vec<Sample>) -> Result<()> {
        let until = Instant::now() + limit;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            if self.client.transport().line().is_simulated() {
                // One nap instead of one for each millisecond.
                std::thread::sleep(left);
                self.client.listen(Duration::ZERO)?;
            } else {
                self.client.listen(left)?;
            }
            self.hear_of_points();
            let more = self.play.as_ref().is_some_and(|play| play.waits_for().is_none() && play.feed.has_room());
            if more && self.phase == Phase::Running && self.plays && Instant::now() < self.window_until {
                self.send_points()?;
            }
            while let Some(told) = self.client.take_telemetry() {
                let sample = words::sample(&told);
                self.supply = (told.supply_v, told.chip_celsius);
                let ended = self.phase == Phase::Running && sample.phase == Phase::Armed && self.plays;
                self.phase = sample.phase;
                // What is broken on purpose tells nothing of the rig.
                if self.injected.is_none() && self.stroke.see(&sample) {
                    self.wizard.revision += 1;
                }
                into.push(sample);
                if let Some(task) = &mut self.task
                    && let Err(error) = task.see(&told)
                {
                    self.end_task(&format!("{error:#}"));
                }
                if ended && self.play.as_ref().is_some_and(|play| play.feed.is_sent()) {
                    // The experiment is over.
                    self.client.send(&Request::Disarm)?;
                }
            }
            self.go_on_with_task()?;
            if Instant::now() >= until {
                return Ok(());
            }
        }
    }
}
