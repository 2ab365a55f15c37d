//! Logs, on stderr: as text for people, or one JSON object a line (time, level, target, fields).

use std::io::IsTerminal;
use tracing_subscriber::EnvFilter;

/// What a program logs and how.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogOptions {
    /// One JSON object a line.
    pub json: bool,
    /// Which messages: as `EnvFilter` reads it.
    pub filter: String,
}

impl LogOptions {
    /// Reads `[text|json][,FILTER]`; `default` is the filter where there is none.
    pub fn parse(text: &str, default: &str) -> Self {
        let mut json = false;
        let mut filter = Vec::new();
        for part in text.split(',').map(str::trim) {
            match part {
                "json" => json = true,
                "text" => json = false,
                "" => {}
                part => filter.push(part),
            }
        }
        let filter = if filter.is_empty() { default.to_owned() } else { filter.join(",") };
        LogOptions { json, filter }
    }
    /// Begins to log. To be called once.
    ///
    /// # Errors
    /// When the filter makes no sense.
    pub fn init(&self) -> Result<(), String> {
        let filter = EnvFilter::try_new(&self.filter).map_err(|e| format!("--log {:?}: {e}", self.filter))?;
        let builder = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
        if self.json {
            builder.json().init();
        } else {
            builder.with_ansi(std::io::stderr().is_terminal()).init();
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn format_and_filter_may_stand_together() {
        let parsed = |text: &str| {
            let LogOptions { json, filter } = LogOptions::parse(text, "warn");
            (json, filter)
        };
        assert_eq!(parsed(""), (false, "warn".into()));
        assert_eq!(parsed("json"), (true, "warn".into()));
        assert_eq!(parsed("debug"), (false, "debug".into()));
        assert_eq!(parsed("json,info,gatherlight=debug"), (true, "info,gatherlight=debug".into()));
        assert_eq!(parsed("text, error"), (false, "error".into()));
    }
}
