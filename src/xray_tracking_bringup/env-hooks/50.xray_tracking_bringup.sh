# ROS 1 lets anybody on the network read and steer what it can reach: masters and nodes of this shell stay on this computer
# unless somebody has said otherwise (docs/security.md). By its name: roscpp takes 127.0.0.1 for any other address.
if [ -z "${ROS_HOSTNAME:-}${ROS_IP:-}" ]; then
  export ROS_HOSTNAME=localhost
fi
