#include <sstream>
#include <stdexcept>

#include "xray_tracking_registration/registration.h"
#include "xray_tracking_registration/similarity.h"

namespace xray_tracking
{
void RegistrationOptions::validate() const
{
  makeSimilarity(similarity);
  const auto checkSimilarity = [](const char* option, double value)
  {
    if (!(value >= -1.0 && value <= 1.0))
    {
      std::ostringstream text;
      text << option << " is " << value << ": expected -1 to 1";
      throw std::invalid_argument(text.str());
    }
  };
  checkSimilarity("min_similarity", min_similarity);
  checkSimilarity("min_coarse_similarity", min_coarse_similarity);
  if (projector != Projector::SHEAR_WARP && optimiser == Optimiser::GAUSS_NEWTON)
  {
    throw std::invalid_argument("projector is not shear_warp: expected a derivative-free optimiser with it");
  }
  if (!(max_deviation_mm > 0.0))
  {
    std::ostringstream text;
    text << "max_deviation_mm is " << max_deviation_mm << ": expected more than 0";
    throw std::invalid_argument(text.str());
  }
}
}  // namespace xray_tracking
