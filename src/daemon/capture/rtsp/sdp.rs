//! The description of a camera's streams (SDP, RFC 8866, as RTSP uses it).
//!
//! Owns which stream is taken: the first video that can be decoded, H.265 last. Knows no network.

use crate::daemon::foreign::shown;
use base64::{Engine, prelude::BASE64_STANDARD as BASE64};

/// Most parameter sets that a description may bring, and the longest of them, bytes.
const MAX_SETS: usize = 8;
const MAX_SET: usize = 4 << 10;

/// How pictures are coded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Codec {
    /// H.264 (RFC 6184).
    H264,
    /// H.265 (RFC 7798).
    #[cfg(feature = "h265")]
    H265,
    /// JPEG (RFC 2435).
    Jpeg,
    /// One that is not read, by its name.
    Other(String),
}

/// The stream that is taken.
#[derive(Clone, Debug, PartialEq)]
pub struct Video {
    /// How its pictures are coded.
    pub codec: Codec,
    /// Where it is set up, as the description has it.
    pub control: Option<String>,
    /// Where the whole session is played, as the description has it.
    pub session_control: Option<String>,
    /// Parameter sets that come in the description.
    pub sets: Vec<Vec<u8>>,
    /// Pictures a second, where it says so.
    pub framerate: Option<f32>,
}

/// Reads a description. `None`: it has no video.
pub fn video(text: &str) -> Option<Video> {
    let mut session_control = None;
    let mut videos: Vec<Media<'_>> = Vec::new();
    let mut in_media = false;
    for line in text.lines() {
        let Some((kind, value)) = line.trim().split_once('=') else { continue };
        if kind == "m" {
            in_media = true;
            let mut words = value.split_ascii_whitespace();
            let is_video = words.next().is_some_and(|word| word.eq_ignore_ascii_case("video"));
            videos.push(Media {
                is_video,
                format: words.nth(2).unwrap_or_default(),
                ..Media::default()
            });
        } else if kind == "a" {
            match videos.last_mut() {
                Some(media) => media.attribute(value),
                None if !in_media => {
                    if let Some(control) = value.strip_prefix("control:") {
                        session_control = Some(control.trim().to_owned());
                    }
                }
                None => {}
            }
        }
    }
    // Of several the first whose pictures cost least to read.
    let rank = |media: &&Media<'_>| match media.codec() {
        Codec::H264 | Codec::Jpeg => 0,
        #[cfg(feature = "h265")]
        Codec::H265 => 1,
        Codec::Other(_) => 2,
    };
    let media = videos.iter().filter(|media| media.is_video).min_by_key(rank)?;
    Some(Video {
        codec: media.codec(),
        control: media.control.map(str::to_owned),
        session_control,
        sets: media.sets(),
        framerate: media.framerate,
    })
}

#[derive(Clone, Debug, Default)]
struct Media<'a> {
    is_video: bool,
    /// Its first payload type.
    format: &'a str,
    encoding: Option<&'a str>,
    parameters: Option<&'a str>,
    control: Option<&'a str>,
    framerate: Option<f32>,
}

impl<'a> Media<'a> {
    fn attribute(&mut self, value: &'a str) {
        let Some((name, value)) = value.split_once(':') else { return };
        let value = value.trim();
        let own =
            value.split_once(char::is_whitespace).filter(|(format, _)| *format == self.format);
        match name.trim() {
            "control" => self.control = Some(value),
            "framerate" => {
                self.framerate = value.parse().ok().filter(|rate| (0.01..=1000.0).contains(rate));
            }
            "rtpmap" => self.encoding = own.map(|(_, encoding)| encoding).or(self.encoding),
            "fmtp" => self.parameters = own.map(|(_, parameters)| parameters).or(self.parameters),
            _ => {}
        }
    }

    fn codec(&self) -> Codec {
        let name = self.encoding.and_then(|encoding| encoding.trim().split('/').next());
        match name.map(str::to_ascii_uppercase).as_deref() {
            Some("H264") => Codec::H264,
            #[cfg(feature = "h265")]
            Some("H265") => Codec::H265,
            Some("JPEG") => Codec::Jpeg,
            None if self.format == "26" => Codec::Jpeg,
            Some(name) => Codec::Other(shown(name)),
            None => Codec::Other(format!("payload type {}", shown(self.format))),
        }
    }

    fn sets(&self) -> Vec<Vec<u8>> {
        let parameters = self.parameters.unwrap_or_default();
        // Of H.264, then of H.265.
        let names = ["sprop-parameter-sets", "sprop-vps", "sprop-sps", "sprop-pps"];
        let values = names.into_iter().filter_map(|wanted| {
            parameters.split(';').find_map(|parameter| {
                let (name, value) = parameter.split_once('=')?;
                name.trim().eq_ignore_ascii_case(wanted).then_some(value.trim())
            })
        });
        let sets = values.flat_map(|value| value.split(',')).take(MAX_SETS);
        sets.filter(|set| !set.is_empty() && set.len() <= MAX_SET)
            .filter_map(|set| BASE64.decode(set.trim()).ok())
            .collect()
    }
}

/// What is wrong with a stream of this codec, and what to do.
pub fn unread(codec: &str) -> String {
    let read = if cfg!(feature = "h265") { "H.264, H.265 and JPEG" } else { "H.264 and JPEG" };
    format!(
        "the camera streams {codec}: this verge reads {read}. Set this stream, or the substream, \
         to H.264"
    )
}

/// The address of a stream: its control attribute against the address that was described.
pub fn resolve(base: &str, control: Option<&str>) -> String {
    match control {
        None | Some("" | "*") => base.to_owned(),
        Some(control)
            if control.to_ascii_lowercase().starts_with("rtsp") && control.contains("://") =>
        {
            control.to_owned()
        }
        // A query in the base stays in front: so do the servers that have one.
        Some(control) if base.ends_with('/') => format!("{base}{control}"),
        Some(control) => format!("{base}/{control}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_video_that_can_be_read_is_taken() {
        let text = "v=0\r\na=control:*\r\nm=audio 0 RTP/AVP 0\r\na=control:a\r\n\
                    m=video 0 RTP/AVP 98\r\na=rtpmap:98 H265/90000\r\n\
                    m=video 0 RTP/AVP 96\r\na=framerate:12.5\r\na=rtpmap:96 H264/90000\r\n\
                    a=fmtp:96 packetization-mode=1; sprop-parameter-sets=Z0I=,aM4=\r\na=control:trackID=1\r\n";
        let video = video(text).expect("a video");
        assert_eq!(video.codec, Codec::H264);
        assert_eq!((video.control.as_deref(), video.framerate), (Some("trackID=1"), Some(12.5)));
        assert_eq!(video.session_control.as_deref(), Some("*"));
        assert_eq!(video.sets, [vec![0x67, 0x42], vec![0x68, 0xce]]);
    }

    #[test]
    fn other_codecs_are_named() {
        let one = |text: &str| video(text).map(|video| video.codec);
        assert_eq!(one("m=video 0 RTP/AVP 26\n"), Some(Codec::Jpeg));
        let text = "m=video 0 RTP/AVP 98\na=rtpmap:98 VP9/90000\n";
        assert_eq!(one(text), Some(Codec::Other("VP9".into())));
        assert_eq!(one("m=audio 0 RTP/AVP 0\n"), None);
        assert_eq!(one(""), None);
    }

    #[test]
    fn h265_is_read_where_it_was_built_in() {
        let text = "m=video 0 RTP/AVP 98\na=rtpmap:98 H265/90000\n\
                    a=fmtp:98 sprop-vps=QAE=; sprop-sps=QgE=;sprop-pps=RAE=\n";
        let video = video(text).expect("a video");
        assert_eq!(video.sets, [[0x40, 1], [0x42, 1], [0x44, 1]]);
        #[cfg(feature = "h265")]
        assert_eq!(video.codec, Codec::H265);
        #[cfg(not(feature = "h265"))]
        assert_eq!(video.codec, Codec::Other("H265".into()));
    }

    #[test]
    fn controls_are_resolved_as_servers_mean_them() {
        for (base, control, expected) in [
            ("rtsp://c/s", Some("trackID=1"), "rtsp://c/s/trackID=1"),
            ("rtsp://c/s/", Some("trackID=1"), "rtsp://c/s/trackID=1"),
            ("rtsp://c/s?a=1", Some("track1"), "rtsp://c/s?a=1/track1"),
            ("rtsp://c/s", Some("rtsp://d/t"), "rtsp://d/t"),
            ("rtsp://c/s", Some("*"), "rtsp://c/s"),
            ("rtsp://c/s", None, "rtsp://c/s"),
        ] {
            assert_eq!(resolve(base, control), expected);
        }
    }
}
