#!/bin/sh
# Makes the runs that the tests read, serial/ and parallel/, with OpenFOAM v1912 (Debian: apt-get install openfoam).
#   sh run.sh          remakes them beside this script
#   sh run.sh FOLDER   makes them in FOLDER
set -eu
here=$(cd "$(dirname "$0")" && pwd)
target=$(mkdir -p "${1:-$here}" && cd "${1:-$here}" && pwd)
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
export WM_PROJECT_DIR="${WM_PROJECT_DIR:-/usr/share/openfoam}"
solver=icoUncoupledKinematicParcelFoam

prepare() { # name, format, compression
    cp -r "$here/case" "$scratch/$1"
    cd "$scratch/$1"
    sed -i "s/FORMAT/$2/; s/COMPRESSION/$3/" system/controlDict
    blockMesh > log.blockMesh
}

prepare serial ascii on
$solver > log.$solver

prepare parallel binary off
decomposePar > log.decomposePar
mpirun --allow-run-as-root --oversubscribe -np 2 $solver -parallel > log.$solver
reconstructPar -latestTime -noLagrangian > log.reconstructPar

for name in serial parallel; do
    cd "$scratch/$name"
    rm -rf "$target/$name"
    for path in system/controlDict constant/kinematicCloudProperties \
        constant/polyMesh/boundary* constant/polyMesh/faces* constant/polyMesh/points* \
        processor*/constant/polyMesh/faceProcAddressing* processor*/constant/polyMesh/boundary \
        processor*/0.02/kinematicCloudQ* 0.02/kinematicCloudQ* postProcessing; do
        if [ -e "$path" ]; then
            mkdir -p "$target/$name/$(dirname "$path")"
            cp -r "$path" "$target/$name/$path"
        fi
    done
done
