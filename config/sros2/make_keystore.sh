#!/bin/sh
# Make an SROS 2 keystore with keys and permissions for the nodes of pipeline_tracker.
# Needs the tools of a full ROS 2 (`ros2 security`, apt's ros-jazzy-sros2).
#
#   make_keystore.sh KEYSTORE [NAMESPACE]
#
# NAMESPACE is that of the nodes, such as /auv1; without it they are in none.
set -eu

if [ $# -lt 1 ] || [ $# -gt 2 ]; then
  echo "make_keystore.sh: expected KEYSTORE [NAMESPACE]" >&2
  exit 2
fi
keystore=$1
namespace=${2:-/}
case $namespace in
  /) ;;
  */ | *[!A-Za-z0-9_/]* | *//*)
    echo "make_keystore.sh: namespace $namespace, expected one like /auv1" >&2
    exit 2
    ;;
  /*) ;;
  *)
    echo "make_keystore.sh: namespace $namespace, expected one that begins with /" >&2
    exit 2
    ;;
esac
if ! command -v ros2 > /dev/null; then
  echo "make_keystore.sh: ros2 is not found; source a full ROS 2 Jazzy that has sros2" >&2
  exit 2
fi

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
sed "s|ns=\"/\"|ns=\"$namespace\"|" "$(dirname "$0")/policy.xml" > "$scratch/policy.xml"

[ -d "$keystore/enclaves" ] || ros2 security create_keystore "$keystore"
sed -n 's|.*<enclave path="\(.*\)">.*|\1|p' "$scratch/policy.xml" | while read -r enclave; do
  [ -d "$keystore/enclaves$enclave" ] || ros2 security create_enclave "$keystore" "$enclave"
  ros2 security create_permission "$keystore" "$enclave" "$scratch/policy.xml"
done
echo "written to $keystore; use it with"
echo "  export ROS_SECURITY_KEYSTORE=$keystore ROS_SECURITY_ENABLE=true ROS_SECURITY_STRATEGY=Enforce"
echo "  pipeline-tracker run ... --ros-args --enclave /pipeline_tracker"
