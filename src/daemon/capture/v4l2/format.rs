//! Formats of a device: what it offers, what it is set to, and how its bytes become a picture.

use super::failed;
use crate::daemon::capture::device::{DeviceError, DeviceSettings};
use crate::daemon::capture::negotiate::{Choice, Encoding, FrameTime, Offer, stepped};
use crate::daemon::capture::picture::pixels::{self, Colour, Layout};
use crate::daemon::capture::{CaptureError, DecodeError, MAX_PICTURE, decode_held, queue};
use crate::daemon::frame::Picture;
use v4l::format::{Colorspace, Quantization};
use v4l::frameinterval::FrameIntervalEnum;
use v4l::framesize::FrameSizeEnum;
use v4l::video::Capture;
use v4l::video::capture::Parameters;
use v4l::{Device, Format, FourCC, Fraction};

/// How the bytes of a stream become a picture.
#[derive(Clone, Copy, Debug)]
pub(super) struct Given {
    pub(super) encoding: Encoding,
    pub(super) layout: Layout,
    colour: Colour,
    /// Memory of all buffers, bytes.
    buffered: u64,
}

impl Given {
    pub(super) fn convert(&self, bytes: &[u8], picture: &mut Picture) -> Result<(), DecodeError> {
        match self.encoding {
            Encoding::Yuyv => pixels::yuyv(bytes, self.layout, self.colour, picture),
            Encoding::Nv12 => pixels::nv12(bytes, self.layout, self.colour, picture),
            Encoding::Grey => pixels::grey(bytes, self.layout, picture),
            Encoding::Mjpg => decode_held(bytes, self.buffered, None, picture),
        }
    }
}

/// The camera's formats, as far as they can be read here.
pub(super) fn offers(
    device: &Device,
    settings: &DeviceSettings,
) -> Result<Vec<Offer>, CaptureError> {
    let formats = device.enum_formats().map_err(|e| failed(settings, "ENUM_FMT", &e))?;
    let mut offers = Vec::new();
    for encoding in Encoding::ALL {
        let fourcc = FourCC::new(&encoding.fourcc());
        if !formats.iter().any(|format| format.fourcc == fourcc) {
            continue;
        }
        for listed in device.enum_framesizes(fourcc).unwrap_or_default() {
            let size = match listed.size {
                FrameSizeEnum::Discrete(size) => (size.width, size.height),
                // Any size in steps: the wanted one, as near as the steps allow.
                FrameSizeEnum::Stepwise(s) => (
                    stepped(settings.size.0, s.min_width, s.max_width, s.step_width),
                    stepped(settings.size.1, s.min_height, s.max_height, s.step_height),
                ),
            };
            if size.0 <= MAX_PICTURE.0 && size.1 <= MAX_PICTURE.1 && size.0 > 0 && size.1 > 0 {
                offers.push(Offer { encoding, size, times: times(device, fourcc, size) });
            }
        }
    }
    Ok(offers)
}

fn times(device: &Device, fourcc: FourCC, (width, height): (u32, u32)) -> Vec<FrameTime> {
    let time = |f: Fraction| FrameTime { numerator: f.numerator, denominator: f.denominator };
    let listed = device.enum_frameintervals(fourcc, width, height).unwrap_or_default();
    listed
        .into_iter()
        .flat_map(|listed| match listed.interval {
            FrameIntervalEnum::Discrete(fraction) => vec![time(fraction)],
            FrameIntervalEnum::Stepwise(steps) => vec![time(steps.min), time(steps.max)],
        })
        .collect()
}

pub(super) fn describe(offers: &[Offer]) -> String {
    let mut text: Vec<_> = offers
        .iter()
        .map(|o| format!("{} {}x{}", FourCC::new(&o.encoding.fourcc()), o.size.0, o.size.1))
        .collect();
    text.dedup();
    if text.is_empty() { "none of these formats".to_owned() } else { text.join(", ") }
}

/// Asks for a format and rate, and holds the camera to the format. With it, how many buffers its
/// stream gets.
pub(super) fn set(
    device: &Device,
    settings: &DeviceSettings,
    choice: Choice,
) -> Result<(Given, u32), CaptureError> {
    let (width, height) = choice.size;
    let fourcc = FourCC::new(&choice.encoding.fourcc());
    // A format that was read back and changed would keep the old one's stride.
    let given = device
        .set_format(&Format::new(width, height, fourcc))
        .map_err(|e| failed(settings, "S_FMT", &e))?;
    if given.fourcc != fourcc || (given.width, given.height) != choice.size {
        return Err(DeviceError::OtherFormat {
            path: settings.path.clone(),
            asked: format!("{fourcc} {width}x{height}"),
            given: format!("{} {}x{}", given.fourcc, given.width, given.height),
        }
        .into());
    }
    if let Some(FrameTime { numerator, denominator }) = choice.time {
        let wanted = Parameters::new(Fraction::new(numerator, denominator));
        // A camera that keeps its own rate is read at that.
        if let Err(error) = device.set_params(&wanted) {
            log::debug!("{}: S_PARM: {error}", settings.path.display());
        }
    }
    let colour = match (given.colorspace, given.quantization) {
        (Colorspace::Rec709, _) => Colour::Bt709,
        (Colorspace::JPEG, _) | (_, Quantization::FullRange) => Colour::Bt601Full,
        _ => Colour::Bt601,
    };
    let (width, height) = (width as usize, height as usize);
    let layout = Layout { width, height, stride: given.stride as usize };
    let buffers = queue::buffers(given.size).ok_or_else(|| DeviceError::LargeFrames {
        path: settings.path.clone(),
        bytes: given.size,
    })?;
    let buffered = u64::from(buffers) * u64::from(given.size);
    Ok((Given { encoding: choice.encoding, layout, colour, buffered }, buffers))
}
