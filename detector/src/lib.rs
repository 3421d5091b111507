//! The detector, offline: data mix, evaluation, training, quantisation.
