#pragma once

#include "train/loop/metrics_log.h"

#include <filesystem>

namespace gld {

// Draws the course of training into file.svg and file.png: the losses, the validation numbers, and the learning
// rate. Nothing is drawn before there are two lines of metrics.
void draw_loss_curve(const MetricsLog& metrics, const std::filesystem::path& file_without_ending);

}  // namespace gld
