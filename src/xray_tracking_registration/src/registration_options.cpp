#include <sstream>
#include <stdexcept>

#include "xray_tracking_registration/registration.h"
#include "xray_tracking_registration/similarity.h"

namespace xray_tracking
{
void RegistrationOptions::validate() const
{
  makeSimilarity(similarity);
  if (projector != Projector::SHEAR_WARP && optimiser == Optimiser::GAUSS_NEWTON)
  {
    throw std::invalid_argument("projector is not shear_warp: expected bobyqa as the optimiser with it");
  }
  if (!(min_probability >= 0.0 && min_probability <= 1.0))
  {
    std::ostringstream text;
    text << "min_probability is " << min_probability << ": expected 0 to 1";
    throw std::invalid_argument(text.str());
  }
}
}  // namespace xray_tracking
