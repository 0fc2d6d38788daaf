# To be sourced, by bash or zsh, from any directory:   . scripts/env.sh
# Puts pcontact, python and what PETSc needs in place in this shell; sets up first if that was not done.

if [ -n "${BASH_VERSION:-}" ]; then
    _pcontact_here=${BASH_SOURCE[0]}
elif [ -n "${ZSH_VERSION:-}" ]; then
    eval '_pcontact_here=${(%):-%x}'
else
    _pcontact_here=${PCONTACT_ROOT:-.}/scripts/env.sh    # other shells do not say where a sourced file lies
fi
_pcontact_here=$(cd "$(dirname "$_pcontact_here")" && pwd)

if _pcontact_lines=$(bash "$_pcontact_here/setup.sh" --env); then
    eval "$_pcontact_lines"
    unset _pcontact_here _pcontact_lines
else
    unset _pcontact_here _pcontact_lines
    return 2
fi
