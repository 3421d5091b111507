//! verge: a calibrated sensor of traffic density.
