#pragma once

#include <vector>

#include <opencv2/core.hpp>

namespace xray_tracking
{
/// Rows and columns of a detector, or halves of them, of another gain or offset than their neighbours.
///
/// No pixel of them need be apart from its neighbours by more than noise: nearly all of the line are brighter, or
/// nearly all darker, than the pixels up to 3 px before and behind, by more than pixels of other lines
/// differ, and than both neighbours do. An edge
/// is brighter than what is on one side of it alone. The ridge of a long bone's cortex may lie along half a row; but it
/// rises towards both sides as a detector's blur lets it, where a line of the detector's own ends in a step.
class FaultyLines
{
public:
  /// Sets STUCK in the flaws of a part of an image, for lines up to 3 px wide; neighbours with a flaw do not count.
  /// Where a quarter of the rows, or of the columns, are odd, none of them is marked.
  void mark(const cv::Mat& image, const cv::Rect& part, cv::Mat& flaws);

private:
  /// One of which nearly all pixels are brighter than both neighbours, or nearly all darker.
  struct Line
  {
    int y;
    float apart;   ///< median over its pixels of how far they are from the nearer one of both
    float across;  ///< and of how far these are from each other
  };

  void markRows(const cv::Mat& values, const cv::Mat& flaws, cv::Mat& faulty);
  /// Takes in one half of row y, against those `reach` before and behind, if it has pixels enough.
  void compare(const cv::Mat& values, const cv::Mat& flaws, const cv::Mat& faulty, const cv::Range& columns, int y,
               int reach);

  /// How much brighter a row is than another one: the mean of the middle half of pixels without a flaw.
  float rise(const cv::Mat& values, const cv::Mat& flaws, const cv::Range& columns, int from, int to);
  /// Whether what is beside a group of odd lines lies apart from it, but not from what is behind.
  bool isStep(const cv::Mat& values, const cv::Mat& flaws, const cv::Range& columns, const cv::Range& group);

  cv::Mat values_, faulty_, turned_values_, turned_flaws_, turned_faulty_;
  std::vector<Line> odd_;
  std::vector<float> apart_;
  std::vector<float> usual_;  ///< how far pixels are from the line before, median of a line
  std::vector<float> across_;
};
}  // namespace xray_tracking
